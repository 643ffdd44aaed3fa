"""One class for each physical effect a scene can name; nothing else is ever assembled.

Enters: terms, energies, flags, the reading of their data. Stays out: meshes and formulas, which a Sampler turns into
Functions; the obstacle, which is a constraint and no effect.
"""
