"""Hard scenes: every result is correct or rejected with a reason; everything else is a failure."""
