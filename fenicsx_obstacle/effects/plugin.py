"""Plug-ins: Python files that register effects and pairs."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from fenicsx_obstacle.errors import InputError, ObstacleError


def load_plugin(file: str | Path) -> None:
    """Run a Python file, whose registered effects and pairs scenes may name then (every rank reads it).

    Raises:
        InputError: If there is no such file, or it fails.
    """
    path = Path(file)
    spec = spec_from_file_location(f"fenicsx_obstacle_plugin_{path.stem}", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"--plugin {path}: no such Python file")
    module = sys.modules[spec.name] = module_from_spec(spec)  # dataclasses look for the module of their class
    try:
        spec.loader.exec_module(module)
    except ObstacleError:
        raise
    except Exception as error:  # whatever the file does wrong is its author's to read
        raise InputError(f"--plugin {path}: {type(error).__name__}: {error}") from None
