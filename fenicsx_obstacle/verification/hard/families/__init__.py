"""Families of drawn scenes whose truth is known beforehand, from closed forms or a reference of their own.

None of these modules uses the error bound, the solvers or the parser of formulas to say what is right.
"""
