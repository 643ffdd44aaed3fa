"""Plug-ins: Python files that register effects and pairs."""

from __future__ import annotations

import sys
from hashlib import sha256
from pathlib import Path
from types import ModuleType

from fenicsx_obstacle.errors import InputError, ObstacleError

_INSTALLED = (Path(sys.prefix), Path(sys.base_prefix), Path(__file__).parent.parent)  # code that has versions
contents: list[str] = []
"""Hashes of the plug-ins that were loaded, and of the modules that they imported and that are not installed."""


def load_plugin(file: str | Path) -> None:
    """Run a Python file, whose registered effects and pairs scenes may name then (every rank reads it).

    Raises:
        InputError: If there is no such file, or it fails.
    """
    path = Path(file)
    if not path.is_file() or path.suffix != ".py":
        raise InputError(f"--plugin {path}: no such Python file")
    module, before = ModuleType(f"fenicsx_obstacle_plugin_{path.stem}"), set(sys.modules)
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look for the module of their class
    try:
        text = path.read_bytes()
        exec(compile(text, path, "exec"), module.__dict__)  # and not what Python has cached of a file of this date
    except ObstacleError:
        raise
    except Exception as error:  # whatever the file does wrong is its author's to read
        raise InputError(f"--plugin {path}: {type(error).__name__}: {error}") from None
    contents.append(sha256(text).hexdigest())
    for name in sorted(set(sys.modules) - before - {module.__name__}):
        source = Path(getattr(sys.modules[name], "__file__", None) or "/")
        if source.is_file() and not any(source.is_relative_to(place) for place in _INSTALLED):
            contents.append(sha256(source.read_bytes()).hexdigest())
