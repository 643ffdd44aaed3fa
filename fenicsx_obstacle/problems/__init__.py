"""The library on DOLFINx objects: ObstacleProblem, made of a form or of effects, and its Solution.

Enters: what a user of DOLFINx calls, without any scene. Stays out: formulas and files of scenes; pictures, but for the
late import of `Solution.plot`.
"""
