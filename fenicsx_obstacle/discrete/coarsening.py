"""Coarse levels without coarse meshes: which nodes stay, and how the others are interpolated from them.

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

from fenicsx_obstacle.discrete.transfer import Transfer
from fenicsx_obstacle.parallel import before, total

SMALL = 0.05  # weights of less are dropped
RANGE = (-0.2, 1.2)  # of weights: others are extrapolation
WIDE = (-0.5, 1.5)  # beyond it weights are not used at all
COINCIDENT = 1e-6  # of the distance to the farthest candidate: two nodes at one place
SINGULAR = 1e-8  # of the trace of a covariance: what its eigenvalues are raised by
NEARLY_NOTHING = 1e-10  # where there is one candidate only; distances are at most 1
FREE, BOUNDARY, FIXED = 0, 1, 2  # kinds of nodes, in the order in which they are preferred


@dataclass(frozen=True, eq=False)
class Nodes:
    """Owned nodes of a level, as coarsening sees them.

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
        """Those of an array of row numbers, with new keys."""
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
            return columns - self.first
        inside = (columns >= self.first) & (columns < self.first + self.own)
        return np.where(inside, columns - self.first, self.own + np.searchsorted(self.numbers, columns))

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

    Nodes at one place, such as the two sides of a slit, have the same coordinates but other neighbours.

    Args:
        A: Stiffness matrix.
        x: Coordinates of owned nodes, shape (nodes, 3).
    """
    starts, columns, _ = A.getValuesCSR()
    ghosts = Ghosts(A, columns, of_rows=True)
    own = hashed(*np.ascontiguousarray(x.T))
    around = ghosts.extended(own)[ghosts.local(columns)]
    ghosts.free()
    return hashed(own, np.maximum.reduceat(around, starts[:-1]) if len(own) else own)


def independent(starts: np.ndarray, columns: np.ndarray, priority: np.ndarray, ghosts: Ghosts, comm: MPI.Comm
                ) -> np.ndarray:  # fmt: skip
    """A maximal independent set of a graph by Luby's algorithm, as flags of owned nodes (collective).

    Args:
        starts: Where the neighbours of each owned node begin in `columns`.
        columns: Places of the neighbours, owned or ghosts.
        priority: Of owned nodes, different between neighbours; the same whatever the distribution over ranks.
        ghosts: Of the graph.
        comm: Communicator.
    """
    own = len(priority)
    rows = np.repeat(np.arange(own, dtype=np.int32), np.diff(starts))
    apart = rows != columns
    rows, columns = rows[apart], columns[apart].astype(np.int32)
    value = ghosts.extended(priority)
    undecided, chosen = np.ones(own, dtype=bool), np.zeros(own, dtype=bool)
    while total(comm, np.count_nonzero(undecided)) > 0:
        best = np.full(own, -1.0)
        if len(rows):
            begin = np.flatnonzero(np.concatenate([[True], rows[1:] != rows[:-1]]))
            best[rows[begin]] = np.maximum.reduceat(value[columns], begin)
        new = undecided & (value[:own] > best)
        if total(comm, np.count_nonzero(new)) == 0:  # neighbours of the same priority: the first goes on
            numbers = ghosts.first + np.arange(own)
            lower = np.where(undecided, hashed(value[:own], numbers.astype(float)), 0.0)
            value = ghosts.extended(lower)
            continue
        chosen |= new
        taken = ghosts.extended(new.astype(float)) > 0
        undecided[rows[taken[columns]]] = False
        undecided &= ~new
        left = ghosts.extended(undecided.astype(float)) > 0
        stay = left[columns]
        stay &= undecided[rows]
        rows, columns = rows[stay], columns[stay]
    return chosen


def coarsen(A: PETSc.Mat, nodes: Nodes, comm: MPI.Comm) -> tuple[Transfer, Nodes]:
    """Choose coarse nodes and interpolate from them (collective).

    Args:
        A: Stiffness matrix without boundary conditions, its graph that of the level.
        nodes: Of its rows.
        comm: Communicator.

    Returns:
        The interpolation, and the coarse nodes, each on the rank of the node that it is.
    """
    starts, columns, _ = A.getValuesCSR()
    ghosts = Ghosts(A, columns, of_rows=True)
    places = ghosts.local(columns)
    chosen = independent(starts, places, nodes.key + nodes.kind, ghosts, comm)
    kept = np.flatnonzero(chosen)
    P = _interpolation(A, starts, places, ghosts, chosen, nodes)
    ghosts.free()
    return Transfer(P, lambda fine: fine[kept].copy()), nodes.only(kept)


def _interpolation(
    A: PETSc.Mat, starts: np.ndarray, places: np.ndarray, ghosts: Ghosts, chosen: np.ndarray, nodes: Nodes
) -> PETSc.Mat:
    """The matrix P (collective)."""
    own, kept, comm = len(chosen), np.flatnonzero(chosen), A.comm.tompi4py()
    first = before(comm, len(kept))
    number = np.full(own, -1.0)
    number[kept] = first + np.arange(len(kept))
    sizes = (own, A.getSize()[0]), (len(kept), int(total(comm, len(kept))))
    # candidates: the pattern of A times its coarse columns
    coarse = ghosts.extended(number)[places].astype(PETSc.IntType)
    B = _matrix(sizes, starts, coarse, (coarse >= 0).astype(float), comm)
    product = A.matMult(B)
    starts, columns, _ = product.getValuesCSR()
    beyond = Ghosts(product, columns, of_rows=False)
    theirs = beyond.local(columns)
    rows = np.repeat(np.arange(own, dtype=np.int32), np.diff(starts))
    weights = (columns == number[rows]).astype(float)
    fixed = beyond.extended((nodes.kind[kept] == FIXED).astype(float)) > 0
    fit = ~chosen[rows] & ((nodes.kind != FIXED)[rows] | fixed[theirs])
    rows, theirs = rows[fit], theirs[fit]
    turn, dim = nodes.tangents, nodes.dim if nodes.tangents is None else 3
    away = np.stack([beyond.extended(x[kept])[theirs] - x[rows] for x in nodes.x.T[:dim]])
    weights[fit] = _weights(away if turn is None else np.einsum("nki,in->kn", turn[rows], away), rows)
    P = _matrix(sizes, starts, columns, weights, comm)
    beyond.free()
    for owner in (B, product):
        owner.destroy()
    return P


def _matrix(sizes: object, starts: np.ndarray, columns: np.ndarray, values: np.ndarray, comm: MPI.Comm) -> PETSc.Mat:
    """The matrix of the values that are not 0 (collective)."""
    there = values != 0
    counts = np.concatenate([[0], np.cumsum(there)])[starts]
    csr = counts.astype(PETSc.IntType), columns[there].astype(PETSc.IntType), values[there]
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=comm)


def _weights(away: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Weights of the candidates of each node, which sum to 1.

    Args:
        away: Where the candidates are, seen from the node, shape (dimension, candidates); changed.
        rows: The node of each, ascending.
    """
    if not len(rows):
        return np.empty(0)
    begin, of = _groups(rows)
    squares = np.einsum("ij,ij->j", away, away)
    farthest = np.maximum.reduceat(squares, begin)
    farthest[farthest == 0] = 1.0
    squares /= farthest[of]
    away *= (1.0 / np.sqrt(farthest))[of]
    apart = squares > COINCIDENT**2
    near = np.divide(1.0, squares, out=np.zeros_like(squares), where=apart)
    near *= near
    if not apart.all():
        near[(np.maximum.reduceat(near, begin) == 0)[of]] = 1.0  # all candidates are at the place of the node
    found = _fitted(away, near, begin, of)
    large = np.abs(found)
    least = np.minimum(SMALL, np.maximum.reduceat(large, begin))
    kept = large >= least[of]
    weights = np.zeros(len(rows))
    weights[kept] = _fitted_again(np.compress(kept, away, axis=1), found[kept], near[kept], of[kept])
    return weights


def _fitted_again(away: np.ndarray, found: np.ndarray, near: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Weights after candidates with small ones were dropped."""
    begin, of = _groups(rows)
    weights = _fitted(away, np.abs(found), begin, of)
    weights /= np.add.reduceat(weights, begin)[of]  # round-off of nearly singular fits
    for (low, high), instead in ((RANGE, found), (WIDE, near)):
        bad = ~((np.minimum.reduceat(weights, begin) >= low) & (np.maximum.reduceat(weights, begin) <= high))
        there = np.flatnonzero(bad[of])
        if len(there):
            sums = np.bincount(of[there], instead[there], len(begin))
            weights[there] = instead[there] / sums[of[there]]
    return weights


def _groups(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where equal rows begin, and the number of the group of each."""
    new = np.empty(len(rows), dtype=bool)
    new[0] = True
    np.not_equal(rows[1:], rows[:-1], out=new[1:])
    begin = np.flatnonzero(new)
    return begin, np.repeat(np.arange(len(begin), dtype=np.int32), np.diff(begin, append=len(rows)))


def _fitted(away: np.ndarray, near: np.ndarray, begin: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Weights by least squares: near those of `near`, and exact for linear functions as far as candidates allow."""
    dim = len(away)
    share = near / np.add.reduceat(near, begin)[of]
    mean = [np.add.reduceat(share * x, begin) for x in away]
    apart = [x - m[of] for x, m in zip(away, mean, strict=True)]
    moment: dict[tuple[int, int], np.ndarray] = {}
    for i in range(dim):
        part = share * apart[i]
        moment |= {(i, j): np.add.reduceat(part * apart[j], begin) for j in range(i, dim)}
    trace = np.sum([moment[i, i] for i in range(dim)], axis=0)
    for i in range(dim):
        moment[i, i] += SINGULAR * trace + NEARLY_NOTHING
    height = np.ones(len(share))
    for x, y in zip(apart, _solved(moment, mean), strict=True):
        x *= y[of]
        height -= x
    share *= height
    return share


def _solved(moment: dict[tuple[int, int], np.ndarray], right: list[np.ndarray]) -> list[np.ndarray]:
    """Solutions of symmetric systems of one to three rows, one for each node, by Cramer's rule."""
    if len(right) == 1:
        return [right[0] / moment[0, 0]]
    a, b, d = moment[0, 0], moment[0, 1], moment[1, 1]
    if len(right) == 2:
        whole = a * d - b * b
        x, y = right
        return [(d * x - b * y) / whole, (a * y - b * x) / whole]
    c, e, f = moment[0, 2], moment[1, 2], moment[2, 2]
    inverse = [d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b]
    whole = a * inverse[0] + b * inverse[1] + c * inverse[2]
    x, y, z = right
    return [
        (inverse[0] * x + inverse[1] * y + inverse[2] * z) / whole,
        (inverse[1] * x + inverse[3] * y + inverse[4] * z) / whole,
        (inverse[2] * x + inverse[4] * y + inverse[5] * z) / whole,
    ]
