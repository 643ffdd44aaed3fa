"""Many answers in a row: convergence in eps and h, and what they cost."""
