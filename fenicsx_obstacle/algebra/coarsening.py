"""Algebraic coarse levels: choice of the coarse nodes, and interpolation from them.

The coarse nodes are a maximal independent set of the graph of A. The others are interpolated from those within two
edges of them by moving least squares, so that linear functions are interpolated exactly. Then the coarse problem is
consistent, and its contact set is near that of the fine one, as on a coarser mesh; with interpolation that is exact
for constants alone, as in classical algebraic multigrid, it is not.

Which nodes are chosen depends on the mesh only, not on how it is distributed over ranks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.kernels import Kernels
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.parallel import before, largest, smallest, total

GRID = 2.0**40  # parts of the longest side of a mesh, to which coordinates are rounded
FREE, BOUNDARY, FIXED = 0, 1, 2  # kinds of nodes, in the order in which they are preferred


@dataclass(frozen=True, eq=False)
class Nodes:
    """Owned nodes of a level with the data that coarsening needs.

    Attributes:
        x: Coordinates, shape (nodes, 3).
        kind: FREE, BOUNDARY (also where contact is on a curve inside) or FIXED.
        key: Numbers between 0 and 1 that look random; on each rank the same for the same node.
        tangents: In each node an orthonormal basis of the tangent space of a surface or curve in space, shape
            (nodes, dimension, 3); None in plane and solid meshes.
        dim: Of the mesh.
    """

    x: np.ndarray
    kind: np.ndarray
    key: np.ndarray
    tangents: np.ndarray | None
    dim: int

    def only(self, chosen: np.ndarray) -> Nodes:
        """A selection of nodes by row numbers, with new keys."""
        tangents = None if self.tangents is None else self.tangents[chosen]
        return Nodes(self.x[chosen], self.kind[chosen], hashed(self.key[chosen]), tangents, self.dim)


def hashed(*values: np.ndarray) -> np.ndarray:
    """A number between 0 and 1 for each row of some arrays, that changes wildly with their last digits."""
    mixed = np.zeros(len(values[0]), dtype=np.uint64)
    with np.errstate(over="ignore"):
        for value in values:  # splitmix64
            mixed ^= (value + 0.0).view(np.uint64)  # -0.0 is 0.0
            mixed += np.uint64(0x9E3779B97F4A7C15)
            mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            mixed ^= mixed >> np.uint64(31)
    return (mixed >> np.uint64(11)).astype(float) * 2.0**-53


class Ghosts:
    """Values of nodes of other ranks that the rows of a matrix refer to (all methods but `local` are collective)."""

    def __init__(self, A: PETSc.Mat, columns: np.ndarray, *, of_rows: bool):
        """Find them.

        Args:
            A: The matrix.
            columns: Those of its owned rows.
            of_rows: Whether values are owned as the rows of A, or as its columns.
        """
        self.first, last = A.getOwnershipRange() if of_rows else A.getOwnershipRangeColumn()
        self.own = last - self.first
        away = columns[(columns < self.first) | (columns >= last)]
        self.numbers = np.unique(away)
        size = (self.own, A.getSize()[0 if of_rows else 1])
        self._vector = PETSc.Vec().createGhost(self.numbers, size, comm=A.comm)

    def local(self, columns: np.ndarray) -> np.ndarray:
        """Places of columns in arrays of owned values followed by those of ghosts."""
        if not len(self.numbers):
            return (columns - self.first).astype(np.int32)
        inside = (columns >= self.first) & (columns < self.first + self.own)
        places = np.where(inside, columns - self.first, self.own + np.searchsorted(self.numbers, columns))
        return places.astype(np.int32)

    def extended(self, owned: np.ndarray) -> np.ndarray:
        """Owned numbers followed by those of ghosts."""
        vector = self._vector
        vector.array[:] = owned
        vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with vector.localForm() as local:
            return local.array.copy()

    def free(self) -> None:
        self._vector.destroy()


def first_keys(A: PETSc.Mat, x: np.ndarray) -> np.ndarray:
    """Keys of the nodes of a mesh (collective).

    They do not depend on the unit of length, or on where the mesh is. Nodes at one place, such as the two sides of a
    slit, have the same coordinates but other neighbours.

    Args:
        A: Stiffness matrix.
        x: Coordinates of owned nodes, shape (nodes, 3).
    """
    starts, columns = A.getValuesCSR()[:2]  # the values would stay
    ghosts = Ghosts(A, columns, of_rows=True)
    comm = A.comm.tompi4py()
    low = np.array([smallest(comm, column) for column in x.T])
    size = max(largest(comm, column - start) for column, start in zip(x.T, low, strict=True)) or 1.0  # all at one place
    own = hashed(*np.ascontiguousarray(np.round((x - low).T * (GRID / size))))
    around = ghosts.extended(own)[ghosts.local(columns)]
    ghosts.free()
    return hashed(own, np.maximum.reduceat(around, starts[:-1]) if len(own) else own)


def independent(
    starts: np.ndarray, places: np.ndarray, priority: np.ndarray, ghosts: Ghosts, loops: Kernels, comm: MPI.Comm
) -> np.ndarray:
    """A maximal independent set of a graph, as flags of owned nodes (collective).

    It is the one that is found by taking nodes in the order of their priority; of neighbours with the same one the
    first by its number is taken. Ranks decide about what does not wait for their neighbours' nodes, in turns.

    Args:
        starts: Where the neighbours of each owned node begin.
        places: Places of the neighbours, owned or ghosts.
        priority: Of owned nodes; the same whatever the distribution over ranks.
        ghosts: Of the graph.
        loops: Compiled.
        comm: Communicator.
    """
    own = len(priority)
    values, numbers = ghosts.extended(priority), np.append(ghosts.first + np.arange(own), ghosts.numbers)
    state, left = np.zeros(len(values), dtype=np.int8), np.empty(own, dtype=np.int32)
    waiting = 1.0
    while waiting > 0:
        count = loops.call("choose", own, starts, places, values, numbers.astype(np.int64), state, left)
        state[own:] = ghosts.extended(state[:own].astype(float))[own:]
        waiting = total(comm, count)
    return state[:own] == 1


def coarsen(A: PETSc.Mat, nodes: Nodes, loops: Kernels, comm: MPI.Comm) -> tuple[Transfer, Nodes]:
    """Choose coarse nodes and interpolate from them (collective).

    Args:
        A: Stiffness matrix without boundary conditions, its graph that of the level.
        nodes: Of its rows.
        loops: Compiled.
        comm: Communicator.

    Returns:
        The interpolation, and the coarse nodes, each on the rank of the node that it is.
    """
    starts, columns = A.getValuesCSR()[:2]  # the values would stay
    ghosts = Ghosts(A, columns, of_rows=True)
    places = ghosts.local(columns)
    chosen = independent(starts.astype(np.int64), places, nodes.key + nodes.kind, ghosts, loops, comm)
    kept, own = np.flatnonzero(chosen), len(chosen)
    number = np.full(own, -1, dtype=np.int64)
    number[kept] = before(comm, len(kept)) + np.arange(len(kept))
    sizes = (own, A.getSize()[0]), (len(kept), int(total(comm, len(kept))))
    # candidates: coarse nodes within two edges, the pattern of A times its coarse columns
    coarse = ghosts.extended(number.astype(float))[places].astype(PETSc.IntType)
    there = coarse >= 0
    begin = np.concatenate([[0], np.cumsum(there)])[starts].astype(PETSc.IntType)
    B = PETSc.Mat().createAIJ(sizes, csr=(begin, coarse[there], np.ones(begin[-1])), comm=comm)
    candidates = A.matMult(B)
    P = _interpolation(candidates, number, nodes, kept, loops)
    ghosts.free()
    for owner in (B, candidates):
        owner.destroy()
    return Transfer(P, lambda fine: fine[kept]), nodes.only(kept)


def _interpolation(
    candidates: PETSc.Mat, number: np.ndarray, nodes: Nodes, kept: np.ndarray, loops: Kernels
) -> PETSc.Mat:
    """The matrix P, whose pattern is part of that of the candidates (collective)."""
    own = len(number)
    starts, columns = candidates.getValuesCSR()[:2]
    ghosts = Ghosts(candidates, columns, of_rows=False)
    coarse = np.stack([ghosts.extended(x) for x in nodes.x[kept].T], axis=1)
    fixed = nodes.kind == FIXED
    longest = int(np.diff(starts).max(initial=0))
    rows, found, weights = np.empty(own + 1, np.int64), np.empty(len(columns), np.int64), np.empty(len(columns))
    used = loops.call(
        "interpolate", own, nodes.dim, starts.astype(np.int64), ghosts.local(columns), nodes.x, coarse, nodes.tangents,
        number, fixed.astype(np.int8), ghosts.extended(fixed[kept].astype(float)), columns.astype(np.int64),
        np.empty(8 * longest), longest, rows, found, weights,
    )  # fmt: skip
    ghosts.free()
    csr = rows.astype(PETSc.IntType), found[:used].astype(PETSc.IntType), weights[:used]
    return PETSc.Mat().createAIJ(candidates.getSizes(), csr=csr, comm=candidates.comm)
