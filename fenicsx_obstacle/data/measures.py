"""UFL measures with weights: of parts of the boundary and of curves inside, and of axial symmetry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import Rule, facet_of, nodal_rule
from fenicsx_obstacle.mesh.levels import Level

MOST = 30  # pairs of a part and a key: each is a bit of a facet's tag


@dataclass(frozen=True)
class Weighted:
    """`integrand * Weighted` is an integral with a weight: over cells, or over facets of the boundary and inside.

    Facets inside have two sides. What is integrated over them is continuous, so either will do.

    Attributes:
        outside: Measure of the cells, or of the facets on the boundary, or None.
        inside: Measure of the facets inside, or None.
        weight: A factor of all integrands, or None.
    """

    outside: ufl.Measure | None
    inside: ufl.Measure | None
    weight: Any = None

    def __call__(self, **how: Any) -> Weighted:
        """The same with another rule: `metadata=...`, as for a measure."""
        outside, inside = (None if part is None else part(**how) for part in (self.outside, self.inside))
        return Weighted(outside, inside, self.weight)

    def __rmul__(self, integrand: Any) -> ufl.Form:
        integrand = integrand if self.weight is None else integrand * self.weight
        parts = [] if self.outside is None else [integrand * self.outside]
        return sum(parts if self.inside is None else [*parts, integrand("+") * self.inside])


class Parts:
    """The measures of all parts of one level.

    Where several parts give a facet the same key, the last one counts.
    """

    def __init__(self, level: Level, parts: Sequence[tuple[int, str, np.ndarray]], *, radial: bool = False):
        """Tag the facets (collective).

        Args:
            level: Mesh.
            parts: Number of a part, a key of it, and the local facets there.
            radial: Give all integrals the weight x.

        Raises:
            InputError: If there are too many.
        """
        if len(parts) > MOST:
            raise InputError(f"more than {MOST} data on parts of the boundary; join parts that have the same")
        self.level, mesh = level, level.mesh
        self.weight = ufl.SpatialCoordinate(mesh)[0] if radial else None
        dim = mesh.topology.dim - 1
        count = mesh.topology.index_map(dim).size_local
        tags = np.zeros(count, dtype=np.int32)
        self._bit: Mapping[tuple[int, str], int] = {
            (number, key): 1 << place for place, (number, key, _) in enumerate(parts)
        }
        for number, key, facets in parts:
            own = facets[facets < count]
            for (_, other), bit in self._bit.items():
                tags[own] &= ~bit if other == key else -1
            tags[own] |= self._bit[number, key]
        tagged = np.flatnonzero(tags).astype(np.int32)
        outside = np.isin(tagged, level.boundary_facets)
        found = (np.unique(tags[tagged[side]]).tolist() for side in (outside, ~outside))
        self._outside, self._inside = (sorted(set().union(*level.comm.allgather(there))) for there in found)
        marks = dmesh.meshtags(mesh, dim, tagged, tags[tagged])
        self._ds = ufl.Measure("ds", domain=mesh, subdomain_data=marks)
        self._dS = ufl.Measure("dS", domain=mesh, subdomain_data=marks)

    def over(self, number: int, key: str, *, nodal: bool = False) -> Weighted:
        """Integration over the part, counted from 0, that has a key."""
        found = self._with(self._bit[number, key])
        return self.rule.on(found) if nodal else found

    def all(self, key: str) -> Weighted:
        """Integration over all parts that have a key."""
        return self._with(sum(bit for (_, other), bit in self._bit.items() if other == key))

    @property
    def rule(self) -> Rule:
        """The nodal rule of the facets."""
        return nodal_rule(facet_of(releases.cell_name(self.level.mesh)), self.level.pair.degree)

    def _with(self, bits: int) -> Weighted:
        """Integration over the facets whose tags have one of these bits."""
        on = []
        for measure, tags in ((self._ds, self._outside), (self._dS, self._inside)):
            ids = tuple(tag for tag in tags if tag & bits)
            on.append(measure(ids) if ids else None)
        return Weighted(on[0], on[1], self.weight)
