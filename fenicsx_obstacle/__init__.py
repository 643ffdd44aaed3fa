"""Obstacle problems on FEniCSx and PETSc: Kikuchi's penalty finite element method with its contact pressure.

Names are loaded when they are first used: importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "Answer": "answers.answer",
    "InputError": "errors",
    "NotConverged": "errors",
    "ObstacleError": "errors",
    "Scene": "scenes.scene",
    "contact_pressure": "forms.penalty",
    "nodal_rule": "forms.rules",
    "penalty": "forms.penalty",
    "compare": "answers.difference",
    "solve": "answers.adapt",
    "solve_form": "answers.bring",
    "study": "studies.convergence",
}

__all__ = [
    "Answer",
    "InputError",
    "NotConverged",
    "ObstacleError",
    "Scene",
    "compare",
    "contact_pressure",
    "nodal_rule",
    "penalty",
    "solve",
    "solve_form",
    "study",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'fenicsx_obstacle' has no attribute '{name}'")
    return getattr(import_module(f"fenicsx_obstacle.{_HOME[name]}"), name)
