"""Studies: convergence in eps and h, cost of accuracy, searches for a value.

Enters: what varies, what is kept of it, what is claimed beside it. Stays out: tables and pictures of the rows, which
`show` makes; studies return numbers.
"""
