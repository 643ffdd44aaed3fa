"""Reading a scene: TOML tables, formulas and the shapes of domains."""
