"""Families of random scenes with known solutions, from closed forms or independent references.

None of these modules uses the error bound, the solvers or the parser of formulas to say what is right.
"""
