"""Kikuchi's statements, each measured: what is claimed, what is observed, and a verdict."""
