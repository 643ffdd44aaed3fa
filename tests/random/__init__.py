"""Random scenes with known solutions."""
