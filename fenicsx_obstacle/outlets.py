"""Where commands print and write: on rank 0, after the places have been checked. Nothing heavy is imported before."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click


def tell(text: str) -> None:
    """Print on rank 0."""
    from mpi4py import MPI

    from fenicsx_obstacle.show.progress import beside_bars

    if MPI.COMM_WORLD.rank == 0:
        with beside_bars(sys.stdout):
            click.echo(text)


def check_places(folder: Path, json_file: str | None, latex: Path | None = None) -> None:
    """Refuse places that cannot be written to before anything is computed (collective)."""
    from mpi4py import MPI

    from fenicsx_obstacle.parallel import check_file, check_folder

    check_folder(MPI.COMM_WORLD, folder)
    for option, file in (("--json", json_file), ("--latex", latex)):
        if file is not None and file != "-":
            check_file(MPI.COMM_WORLD, Path(file), option)


def write_json(file: str, records: Sequence[Any]) -> None:
    """One object in each line of a file; - is standard output (collective)."""
    from mpi4py import MPI

    from fenicsx_obstacle.parallel import on_root, write_lines

    if file == "-":
        tell("\n".join(json.dumps(dict(record)) for record in records))
    else:
        on_root(MPI.COMM_WORLD, write_lines, Path(file), records)
