"""Loops in C, compiled on first use as DOLFINx compiles forms: by CFFI, into the same cache."""

from __future__ import annotations

import importlib.util
import logging
import os
import sys
import tempfile
from functools import cache
from hashlib import sha1
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.parallel import total

_log = logging.getLogger(__name__)
SOURCE = Path(__file__).with_name("coarsening.c")
DECLARATIONS = """
int64_t choose(int64_t, const int64_t *, const int32_t *, const double *, const int64_t *, int8_t *, int32_t *);
int64_t interpolate(int64_t, int, const int64_t *, const int32_t *, const double *, const double *, const double *,
                    const int64_t *, const int8_t *, const double *, const int64_t *, double *, int64_t,
                    int64_t *, int64_t *, double *);
"""


class Kernels:
    """The functions of coarsening.c; arrays are passed as they are, and must be of the types that C expects."""

    def __init__(self, module: Any):
        self._functions, self._ffi = module.lib, module.ffi

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function with numbers, contiguous arrays, and None for NULL."""
        types = {"float64": "double[]", "int64": "int64_t[]", "int32": "int32_t[]", "int8": "int8_t[]"}
        given = []
        for one in arguments:
            if isinstance(one, np.ndarray):
                # CFFI takes no buffer of nothing
                given.append(self._ffi.from_buffer(types[one.dtype.name], one) if one.size else self._ffi.NULL)
            else:
                given.append(self._ffi.NULL if one is None else one)
        return int(getattr(self._functions, name)(*given))


def kernels(comm: MPI.Comm) -> Kernels | None:
    """The compiled functions; None where some rank has no compiler (collective)."""
    if comm.rank == 0:
        _compiled()
    comm.barrier()  # the others find what it has compiled
    mine = _compiled()
    return mine if total(comm, mine is None) == 0 else None


@cache
def _compiled() -> Kernels | None:
    text = SOURCE.read_text(encoding="utf-8")
    name = "libobstacle_" + sha1((text + DECLARATIONS + sys.version).encode()).hexdigest()
    folder = Path(os.getenv("XDG_CACHE_HOME", Path.home() / ".cache")) / "fenics"
    try:
        found = folder / (name + EXTENSION_SUFFIXES[0])
        return Kernels(_imported(name, found if found.exists() else _compile(text, name, folder)))
    except Exception as error:  # CFFI, setuptools, the compiler and the loader each have errors of their own
        _log.warning("the loops of %s cannot be compiled, so that there are no algebraic levels: %s", SOURCE, error)
        return None


def _compile(text: str, name: str, folder: Path) -> Path:
    """Compile in a scratch folder, and move the library to its place in one step."""
    import cffi

    folder.mkdir(parents=True, exist_ok=True)
    builder = cffi.FFI()
    builder.cdef(DECLARATIONS)
    builder.set_source(name, text, extra_compile_args=["-O2"])
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        made = Path(builder.compile(tmpdir=scratch))
        return made.replace(folder / made.name)


def _imported(name: str, path: Path) -> ModuleType:
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
