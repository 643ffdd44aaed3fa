"""PETSc objects that Python has let go of.

petsc4py keeps them, one list for each communicator, until all ranks ask for them to be freed: ranks collect garbage at
different times. Every mesh of DOLFINx has a communicator of its own, which PETSc keeps as long as its objects use it.
"""

from __future__ import annotations

import gc
from collections.abc import Iterable
from weakref import WeakSet

from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.parallel import total

_owners: dict[int, tuple[PETSc.Comm, WeakSet]] = {}  # of PETSc objects, by communicator


def free(comms: Iterable[MPI.Comm]) -> None:
    """Free what Python has let go of, also in cycles of references (collective)."""
    gc.collect()
    for comm in comms:
        free_unreferenced(comm)


def free_unreferenced(comm: MPI.Comm) -> None:
    """Free what Python has let go of so far, without a search for cycles, which takes 10 ms (collective)."""
    PETSc.garbage_cleanup(PETSc.Comm(comm))


def free_before(owner: object, comm: MPI.Comm) -> None:
    """Free what earlier owners have left on the meshes of the same ranks, and note a new owner (collective).

    Args:
        owner: Will have PETSc objects.
        comm: Their communicator.
    """
    gc.collect()
    for number, (theirs, alive) in list(_owners.items()):
        if MPI.Comm.Compare(theirs.tompi4py(), comm) in (MPI.IDENT, MPI.CONGRUENT):
            PETSc.garbage_cleanup(theirs)
            if total(comm, len(alive)) == 0:
                del _owners[number]
    kept = PETSc.Comm(comm).duplicate()
    _owners.setdefault(kept.tompi4py().py2f(), (kept, WeakSet()))[1].add(owner)
