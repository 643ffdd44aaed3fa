"""Parts of the boundary, and curves inside, as measures that a form can be integrated with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import facet_of, nodal_rule

MOST = 30  # pairs of a part and a key: each is a bit of a facet's tag


@dataclass(frozen=True)
class Facets:
    """`integrand * Facets` is the integral over facets of the boundary and over facets inside, which have two sides.

    What is integrated is continuous, so either side will do.

    Attributes:
        outside: Measure of those on the boundary, or None.
        inside: Measure of those inside, or None.
    """

    outside: ufl.Measure | None
    inside: ufl.Measure | None

    def __rmul__(self, integrand: Any) -> ufl.Form:
        parts = [] if self.outside is None else [integrand * self.outside]
        return sum(parts if self.inside is None else [*parts, integrand("+") * self.inside])


class Parts:
    """The measures of all parts of one level.

    Where several [[boundary]] give a facet the same key, the last one counts.
    """

    def __init__(self, level: Level, parts: Sequence[tuple[int, str, np.ndarray]]):
        """Tag the facets (collective).

        Args:
            level: Mesh.
            parts: Number of a [[boundary]], a key of it, and the local facets there.

        Raises:
            InputError: If there are too many.
        """
        if len(parts) > MOST:
            raise InputError(f"[[boundary]] gives more than {MOST} values; join parts that have the same")
        self.level, mesh = level, level.mesh
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

    def over(self, number: int, key: str, *, nodal: bool = False) -> Facets:
        """Integration over the part that a [[boundary]], counted from 0, gives a key."""
        bit, measures = self._bit[number, key], []
        for measure, tags in ((self._ds, self._outside), (self._dS, self._inside)):
            ids = tuple(tag for tag in tags if tag & bit)
            chosen = measure(ids) if ids else None
            if nodal and chosen is not None:
                degree = min(self.level.pair.degree, 2)
                chosen = nodal_rule(facet_of(releases.cell_name(self.level.mesh)), degree).on(chosen)
            measures.append(chosen)
        return Facets(*measures)
