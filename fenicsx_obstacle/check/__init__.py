"""Checks of a solution against its discrete problem."""
