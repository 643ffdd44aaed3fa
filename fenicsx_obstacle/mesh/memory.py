"""Checks that a mesh and a solve on it fit into memory."""

from __future__ import annotations

from mpi4py import MPI

from fenicsx_obstacle.errors import InputError

BYTES_PER_VERTEX = {1: 1300, 2: 1300, 3: 3500}  # of a solve and all its levels, measured
OTHERS = 1.5  # times as much with effects beside tension and load, measured


def fits(unknowns: float, dim: int, comm: MPI.Comm) -> bool:
    """Whether a mesh with so many unknowns, and a solve on it, fit into memory (collective)."""
    return unknowns * BYTES_PER_VERTEX[dim] < 1e6 * free_megabytes(comm) and unknowns * 6 <= 2**31


def check_memory(unknowns: float, dim: int, comm: MPI.Comm, source: str, remedy: str) -> None:
    """Reject a mesh that does not fit into memory (collective).

    Raises:
        InputError: Naming the `source`, with the remedy.
    """
    if not fits(unknowns, dim, comm):
        needed, free = unknowns * BYTES_PER_VERTEX[dim] / 1e9, free_megabytes(comm) / 1e3
        margin = f"{needed:.3g} GB of memory, {free:.3g} GB are free"
        raise InputError(f"{source}: [mesh] needs about {margin}; {remedy}")


def free_megabytes(comm: MPI.Comm) -> float:
    """MB of 10^6 bytes that a new process could have; rank 0 looks, others would at another moment (collective)."""
    with open("/proc/meminfo") as file:
        lines = dict(line.split(":") for line in file)
    return comm.bcast(1024.0 * float(lines["MemAvailable"].split()[0]) / 1e6)
