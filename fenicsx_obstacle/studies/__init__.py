"""Many answers in a row: convergence in eps and h, and what they cost.

Enters: what varies, what is kept of it, what is claimed beside it. Stays out: tables and pictures of the rows, which
`show` makes; studies return numbers.
"""
