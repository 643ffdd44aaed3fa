"""All families whose truth is known."""

from __future__ import annotations

from hypothesis import strategies as st

from fenicsx_obstacle.studies.hard.families import (
    curves,
    drifts,
    files,
    films,
    layers,
    residuals,
    rims,
    smooth,
    support,
)
from fenicsx_obstacle.studies.hard.families.family import Family

KNOWN: dict[str, st.SearchStrategy[Family]] = {
    "layers": layers.layers(),
    "layers in contact": layers.layers_in_contact(),
    "waves": layers.waves(),
    "inclusion": curves.inclusions(),
    "pole": curves.poles(),
    "polynomial": smooth.polynomials(),
    "boundary values": rims.rims(),
    "ends of boundary parts": rims.ends(),
    "obstacle alone": support.unheld(),
    "feeble support": support.feebles(),
    "soft obstacle alone": support.softs(),
    "residual of one's own": residuals.forms(),
    "drift along x": drifts.strips(),
    "drift from a point": drifts.radial(),
    "film": films.films(),
    **({"CAD": files.cad()} if files.there() else {}),
}
