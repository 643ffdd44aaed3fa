"""The library on DOLFINx objects: ObstacleProblem, made of a form or of effects, and its Solution.

Contents: the classes that a DOLFINx user calls, without any scene. Not here: formulas and files of scenes; pictures,
except for the late import in `Solution.plot`.
"""
