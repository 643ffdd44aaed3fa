"""Verification of the program itself: the commands `theory` and `hard`.

Contents: statements of the paper as measurements, hard scenes, random scenes with known solutions, invalid input,
faults of the machine, and the tables and pictures of all these. Not here: code that a user's problem needs; only the
command line imports this package, when one of its commands is called.
"""
