"""Checks of a solution against its discrete problem, whoever has found it."""
