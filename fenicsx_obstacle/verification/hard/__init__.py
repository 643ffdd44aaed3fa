"""Hard scenes: every answer is right, or refused for a reason that is told; anything else has failed."""
