"""The free boundary as a line between the nodes: where a level function of gap and contact vanishes.

Off contact the gap grows like q d^2 / (2 tension) with the distance d to the free boundary, so its square root is
nearly linear there. In contact it is continued linearly, which puts the line between the nodes where the steps of
the 0/1 contact field would only name the edge.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.show.simplices import Patch, gradients, zero

SIDES = {"lower": 1.0, "upper": -1.0}  # sign of the pressure that each obstacle gives
LEVELS = {"lower": "level lower", "upper": "level upper"}  # names of the level functions among the fields
RINGS = 4  # of nodes in contact that the level function is continued to


def with_levels(patch: Patch) -> Patch:
    """The same with the level function of each obstacle among the fields; cuts interpolate it like the others.

    Args:
        patch: An answer with `u`, `pressure`, `contact` and its obstacles as fields.
    """
    levels = {LEVELS[side]: _level_function(patch, side) for side in SIDES if side in patch.fields}
    return Patch(patch.points, patch.cells, {**patch.fields, **levels})


def free_boundary(patch: Patch) -> list[Patch]:
    """The free boundary of each obstacle that is touched, with all fields on it.

    Args:
        patch: From `with_levels`.
    """
    found = [zero(patch, patch.fields[level]) for level in LEVELS.values() if level in patch.fields]
    return [line for line in found if len(line.cells)]


def _level_function(patch: Patch, side: str) -> np.ndarray:
    """Nodal function, negative in contact with this obstacle; its zero line lies within a cell of the contact set."""
    sign, fields = SIDES[side], patch.fields
    gap = np.maximum(sign * (fields["u"] - fields[side]), 0.0)
    touching = (fields["contact"] > 0) & (sign * fields["pressure"] > 0)
    largest = np.sqrt(gap.max(initial=0.0)) or 1.0
    edges = _edges(patch.cells)
    # where the boundary value is the obstacle itself there is no pressure to tell, only contact beside it
    touching |= (gap <= 1e-10 * largest**2) & _touched(touching, edges)
    level = np.where(touching, 0.0, np.sqrt(gap))
    known = ~touching
    for _ in range(RINGS):
        level, known = _continued(patch, level, known, edges)
    level[~known] = level.min()
    for _ in range(RINGS - 1):
        level = _averaged(level, edges)
    # thin sets keep their nodes: where no neighbour is surrounded by nodes of the same kind
    for kind, sign in ((touching, -1.0), (~touching, 1.0)):
        thin = kind & ~_touched(~_touched(~kind, edges), edges)
        level[thin] = sign * np.maximum(sign * level[thin], 1e-6 * largest)
    return level


def _continued(patch: Patch, level: np.ndarray, known: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One more ring of nodes: from each known neighbour along its slope, the mean of all."""
    slopes, steady = _slopes(patch, level, known)
    a, b = edges[~known[edges[:, 0]] & known[edges[:, 1]]].T
    rise = np.einsum("ex,ex->e", slopes[b], patch.points[a] - patch.points[b])
    # where nothing is known of the slope, or it points the wrong way: halfway
    guess = np.where(steady[b] & (rise < 0), level[b] + rise, -np.abs(level[b]))
    count = np.bincount(a, minlength=len(level))
    mean = np.bincount(a, guess, len(level)) / np.maximum(count, 1)
    return np.where(count > 0, mean, level), known | (count > 0)


def _averaged(level: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Half of each value comes from its neighbours: this keeps lines straight and takes the jitter of nodes away."""
    count = np.bincount(edges[:, 0], minlength=len(level))
    sums = np.bincount(edges[:, 0], level[edges[:, 1]], len(level))
    return 0.5 * level + 0.5 * np.where(count > 0, sums / np.maximum(count, 1), level)


def _touched(nodes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """These nodes and their neighbours."""
    result = nodes.copy()
    result[edges[nodes[edges[:, 0]], 1]] = True
    return result


def _slopes(patch: Patch, level: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient at known nodes: the mean over cells with all nodes known; and where there is one."""
    whole = Patch(patch.points, patch.cells[known[patch.cells].all(axis=1)], {})
    if not len(whole.cells):
        return np.zeros_like(patch.points), np.zeros(len(level), dtype=bool)
    slopes, nodes = gradients(whole, level), whole.cells.ravel()
    count = np.bincount(nodes, minlength=len(level))
    per_node = np.repeat(slopes, whole.cells.shape[1], axis=0)
    sums = np.stack([np.bincount(nodes, per_node[:, x], len(level)) for x in range(3)], axis=1)
    return sums / np.maximum(count, 1)[:, None], count > 0


def _edges(cells: np.ndarray) -> np.ndarray:
    """Both directions of all edges, shape (n, 2)."""
    size, count = cells.shape[1], int(cells.max(initial=-1)) + 1
    names = np.concatenate([cells[:, i] * count + cells[:, j] for i in range(size) for j in range(size) if i != j])
    return np.column_stack(np.divmod(np.unique(names), max(count, 1)))
