"""Hard scenes: every result is right, or rejected with a reason; anything else has failed."""
