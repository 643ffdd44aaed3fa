"""Tables and pictures of the commands `theory` and `hard`."""
