"""Studies: convergence in eps and h, cost of accuracy, searches for a value.

Contents: which values vary, which rows are kept, which orders are expected. Not here: tables and pictures of the rows,
which are in `show`; studies return numbers.
"""
