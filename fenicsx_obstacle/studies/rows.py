"""Rows of a study on disk: saved when finished, and found again by a key of all they depend on.

rows.jsonl is the store: one line per row ever computed in this folder. rows.csv is the table of the present study.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from stat import S_ISREG
from typing import IO, Any

import msgspec
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.effects import plugin
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh import files
from fenicsx_obstacle.origin import versions
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import make_folder, remove_empty, write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import csv_of


def row_key(scene: Scene, kind: str, ranks: int) -> str:
    """The key of a row, of the contents of all it depends on (one rank).

    These are the resolved scene, its mesh, its data files, the code of plug-ins, PETSc's options, ranks and versions.

    Args:
        scene: With all values of the row.
        kind: What the study measures beyond the answer.
        ranks: Number of ranks.
    """
    table = scene.tables.mesh
    mesh = "" if table.file is None else files.content_of(scene.folder / table.file)
    options = PETSc.Options().getAll()
    text, data = scene.with_data()
    measured = [hashlib.sha256(content).hexdigest() for content in data.values()]
    given = [text, measured] if data else msgspec.to_builtins(scene.tables)
    parts = [given, mesh, kind, ranks, versions(), options, plugin.contents]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


class RowStore:
    """The rows in a folder, locked by one process: rank 0 reads and writes them for all ranks.

    Attributes:
        folder: Where rows.jsonl and rows.csv are.
        path: rows.jsonl.
        run: Number of this run in this folder; timings are compared within one run only.
    """

    def __init__(self, folder: Path, comm: MPI.Comm = MPI.COMM_SELF, *, fresh: bool = False):
        """Open the folder; `fresh` forgets the rows in it (collective on `comm`, by default this process alone).

        Raises:
            InputError: If the folder cannot be written, or another study is writing there.
        """
        self.folder, self.path, self._comm = folder, folder / "rows.jsonl", comm
        self._rows: dict[str, dict[str, Any]] = {}
        self._lock: IO[str] | None = None
        self.run: int = on_root(self._comm, self._open, fresh)

    def find(self, key: str) -> dict[str, Any] | None:
        """The row of this key, if it was ever finished here (collective)."""
        found: dict[str, Any] | None = on_root(self._comm, self._rows.get, key)
        return found

    def keys(self) -> list[str]:
        """Of all rows (one rank)."""
        return list(self._rows)

    def add(self, key: str, row: Mapping[str, Any]) -> dict[str, Any]:
        """Write a row; when this returns it is on the disk (collective).

        Returns:
            The row with its key and run.

        Raises:
            InputError: If the disk is full or gone.
        """
        kept: dict[str, Any] = on_root(self._comm, self._add, {"key": key, "run": self.run, **row})
        return kept

    def write_table(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """rows.csv: the rows of this study so far (collective)."""
        on_root(self._comm, lambda: write_text(self.folder / "rows.csv", as_csv(rows)))

    def close(self) -> None:
        """Unlock the folder; without a row the file is removed (no MPI calls)."""
        if self._lock is None:
            return
        if not self._rows:
            Path(self._lock.name).unlink(missing_ok=True)
        self._lock.close()
        remove_empty(self._made)

    def _open(self, fresh: bool) -> int:
        """Lock the folder and read its rows; the number of this run."""
        folder, self._made = self.folder, make_folder(self.folder)
        try:
            self._lock = open(folder / ".lock", "w", opener=_no_link)  # noqa: SIM115  (until it is closed)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system releases it even after kill -9
            if fresh:
                self.path.unlink(missing_ok=True)
            self._rows = self._load()
        except BlockingIOError:
            raise InputError(f"{folder}: another study is writing there; choose another folder with --output") from None
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}; choose another folder with --output") from None
        return 1 + max((row.get("run", 0) for row in self._rows.values()), default=0)

    def _add(self, kept: dict[str, Any]) -> dict[str, Any]:
        """Write a row with its content, and keep it."""
        try:
            with open(self.path, "a", opener=_no_link) as file:
                file.write(json.dumps({**kept, "content": _content(kept)}) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}") from None
        self._rows[kept["key"]] = kept
        return kept

    def _load(self) -> dict[str, dict[str, Any]]:
        """Rows on the disk; what a killed process left of a last line is cut off."""
        if not os.path.lexists(self.path):
            return {}
        with open(self.path, "r+b", opener=_no_link) as file:
            text = file.read()
            whole = text[: text.rfind(b"\n") + 1]
            if whole != text:
                file.truncate(len(whole))
        try:
            rows = [json.loads(line) for line in whole.splitlines()]
            # those of version 0.2, without content, are of other keys
            found = {row["key"]: row for row in rows}
            return {key: row for key, row in found.items() if "content" in row and _checked(row)}
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise InputError(f"{self.path}: not written by a study; remove it, or use --fresh or --output") from None


def _content(row: Mapping[str, Any]) -> str:
    """A hash of a row."""
    return hashlib.sha256(json.dumps(json.loads(json.dumps(row)), sort_keys=True).encode()).hexdigest()


def _checked(row: dict[str, Any]) -> bool:
    """Take the content off a row.

    Raises:
        ValueError: If it is not that of the row, or the row has no number of its run.
    """
    if row.pop("content") != _content(row) or not isinstance(row["run"], int):
        raise ValueError
    return True


def _no_link(path: str, flags: int) -> int:
    """Open a file, but not what a link leads to, nor a pipe."""
    if os.path.lexists(path) and not S_ISREG(os.lstat(path).st_mode):  # a pipe without a reader cannot be opened
        raise OSError(errno.EINVAL, "is no file", path)
    number = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    if not S_ISREG(os.fstat(number).st_mode):  # it has been replaced meanwhile
        os.close(number)
        raise OSError(errno.EINVAL, "is no file", path)
    return number


def flat(row: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """One level of dotted keys, as pandas takes them."""
    result: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            result |= flat(value, f"{prefix}{key}.")
        else:
            result[prefix + key] = value
    return result


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as text with one head for all."""
    # profiles have files of their own
    return csv_of([flat({key: value for key, value in row.items() if key != "profiles"}) for row in rows])
