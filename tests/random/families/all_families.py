"""All families with known solutions."""

from __future__ import annotations

from importlib.util import find_spec

from hypothesis import strategies as st

from tests.random.families import (
    axial,
    boundary_values,
    close,
    concentrated,
    conditions,
    curves,
    drifts,
    equilibria,
    files,
    films,
    layers,
    sectors,
    solids,
    supported,
    touching,
    varying,
)
from tests.random.families.family import ClosedForm, Family

# u is a closed form, and a bound of the error is compared with the true one
TRUTHS: dict[str, st.SearchStrategy[ClosedForm]] = {
    "layers": layers.layers(),
    "layers in contact": layers.layers_in_contact(),
    "waves": layers.waves(),
    "inclusion": curves.inclusions(),
    "pole": curves.poles(),
    "polynomial": varying.polynomials(),
    "smooth tension": varying.varying(),
    "conditions": conditions.conditions(),
    "rings": curves.rings(),
    "sectors": sectors.sectors(),
    "corner": sectors.corners(),
    "touching": touching.touching(),
    "supported": supported.supported(),
    "anisotropic": touching.anisotropic(),
    "axial": axial.axial(),
    "bearings": supported.bearings(),
    "loaded string": concentrated.loaded_strings(),
    "loaded line": concentrated.loaded_lines(),
    "tetrahedra": solids.tetrahedra(),
}
TRUTHS = {name: family.filter(lambda one: one.short) for name, family in TRUTHS.items()}
# no obstacles beside u of which the gradient alone is known, nor beside obstacles on sides, or data along a line
ALONE = ("layers in contact", "waves", "bearings", "loaded line")
_bases = st.one_of([family for name, family in TRUTHS.items() if name not in ALONE])
TRUTHS["close obstacles"] = close.close(_bases).filter(lambda one: one.short)
KNOWN: dict[str, st.SearchStrategy[Family]] = {
    **TRUTHS,
    "boundary values": boundary_values.jumps(),
    "ends of boundary parts": boundary_values.ends(),
    "obstacle alone": equilibria.unheld(),
    "feeble support": equilibria.feebles(),
    "soft obstacle alone": equilibria.softs(),
    "drift along x": drifts.strips(),
    "drift from a point": drifts.radial(),
    "film": films.films(),
    **({"CAD": files.cad()} if find_spec("gmsh") else {}),
}
