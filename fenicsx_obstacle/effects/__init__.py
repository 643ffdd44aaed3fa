"""Effects: one class for each physical term that a scene can name.

Each effect is a file: `domain/KEY.py` for a key of [effects], `boundary/KEY.py` for one of [[boundary]].

Contents: terms, energies, properties, and the data of effects, which are Fields. Not here: meshes, on which a Sampler
turns Fields into Functions; the obstacle, which is a constraint and not an effect.
"""
