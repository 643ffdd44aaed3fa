"""Kikuchi's statements, measured: claims, observations, verdicts."""
