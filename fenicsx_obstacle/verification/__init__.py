"""Verification of the program itself: the commands `theory` and `hard`.

Enters: statements of the paper as measurements, hard scenes and random ones with their known truths, input that is
wrong, machines that break, and the tables and pictures of all these. Stays out: what a user's problem needs; only the
command line imports this package, when one of its commands is called.
"""
