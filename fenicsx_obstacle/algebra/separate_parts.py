"""Parts of the unknowns that given values separate: what happens in one says nothing of another."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.coarsening import Ghosts
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import total


def ranges_in_parts(problem: System, u: np.ndarray, owned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The range of u in each part, with the given values around it, and the largest of other numbers (collective).

    Args:
        problem: In the state at which its matrix A was assembled last.
        u: Values at owned dofs.
        owned: Other numbers at these, >= 0.

    Returns:
        Both for each part, the same on all ranks.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    A, comm = problem.A, problem.comm
    starts, columns, values = A.getValuesCSR()
    ghosts = Ghosts(A, columns, of_rows=True)
    places, count = ghosts.local(columns), ghosts.own + len(ghosts.numbers)
    below = np.full(count - ghosts.own, starts[-1], dtype=starts.dtype)
    # entries in rows and columns of fixed dofs are 0
    graph = csr_matrix((values != 0, places, np.append(starts, below)), shape=(count, count))
    graph.eliminate_zeros()
    number, label = connected_components(graph, directed=False)
    part, moved = ghosts.extended(ghosts.first + np.arange(ghosts.own, dtype=float)), 1.0
    while moved > 0:  # its least dof is the number of a part
        least = np.full(number, np.inf)
        np.minimum.at(least, label, part)
        moved = total(comm, np.count_nonzero(least[label] != part))
        part = ghosts.extended(least[label][: ghosts.own])
    free, around = ~problem.fixed, ghosts.extended(u)[places]
    ghosts.free()
    of_rows = [np.empty(0)] * 2
    if ghosts.own:
        of_rows = [of.reduceat(around, starts[:-1]) for of in (np.maximum, np.minimum)]
    highest, lowest = of_rows
    rows = np.column_stack([part[: ghosts.own], highest, -lowest, owned])[free]
    found: dict[float, np.ndarray] = {}
    for one in comm.allgather(_largest_of_each(rows)):
        for row in one:
            found[row[0]] = np.maximum(row, found.get(row[0], row))
    every = np.array(list(found.values())).reshape(-1, 4)
    return every[:, 1] + every[:, 2], every[:, 3]


def _largest_of_each(rows: np.ndarray) -> np.ndarray:
    """Of rows with the same first entry the largest of each other entry."""
    numbers, where = np.unique(rows[:, 0], return_inverse=True)
    found = np.full((len(numbers), rows.shape[1]), -np.inf)
    np.maximum.at(found, where, rows)
    return found
