"""Input that is wrong in every way a file or a command line can be, and what the message about it must name."""
