"""Tests, and the suites of the commands `theory` and `hard`.

`theory` has statements of the paper as measurements, `hard` hard scenes and their judge, `random` random scenes with
known solutions, `cli` invalid input and faults of the machine; each with its tables and pictures.
"""
