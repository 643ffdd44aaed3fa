"""Effects: one class for each physical term that a scene can name.

Each effect is a file: `domain/KEY.py` for a key of [effects], `boundary/KEY.py` for one of [[boundary]].

Enters: terms, energies, flags, the reading of their data, which are Fields. Stays out: meshes, on which a Sampler turns
Fields into Functions; the obstacle, which is a constraint and no effect.
"""
