"""Parts of the unknowns that given values separate: what happens in one says nothing of another."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.coarsening import Ghosts
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import total


class SeparateParts:
    """The parts of a system in its present state; values of a part are the same on all ranks (all is collective).

    Attributes:
        ranges: The range of u in each part, with the given values around it.
    """

    def __init__(self, problem: System, u: np.ndarray):
        """Find them.

        Args:
            problem: In the state at which its matrix A was assembled last.
            u: Values at owned dofs.
        """
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import connected_components

        A, self._comm = problem.A, problem.comm
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
            moved = total(self._comm, np.count_nonzero(least[label] != part))
            part = ghosts.extended(least[label][: ghosts.own])
        around = ghosts.extended(u)[places]
        ghosts.free()
        self._free = ~problem.fixed
        names = part[: ghosts.own][self._free]
        every = np.unique(np.concatenate(self._comm.allgather(np.unique(names))))
        self._count, self._part = len(every), np.searchsorted(every, names)
        highest, lowest = (np.maximum.reduceat(sign * around, starts[:-1]) if ghosts.own else u for sign in (1, -1))
        self.ranges = self.largest(highest) + self.largest(lowest)

    def of_dofs(self) -> np.ndarray:
        """The number of the part of each owned dof; of fixed ones a number beyond (local)."""
        found = np.full(len(self._free), self._count)
        found[self._free] = self._part
        return found

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Of values at owned dofs the largest at free dofs of each part."""
        found = np.full(self._count, -np.inf)
        np.maximum.at(found, self._part, values[self._free])
        return np.max(self._comm.allgather(found), axis=0)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Of values at owned dofs the sum over free dofs of each part."""
        found = np.bincount(self._part, values[self._free], minlength=self._count)
        return np.sum(self._comm.allgather(found), axis=0)
