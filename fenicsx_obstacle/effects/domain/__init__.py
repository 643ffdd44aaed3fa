"""The effects of [effects], one in each module: a file is named as the key that scenes write."""
