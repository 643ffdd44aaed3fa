"""All families whose truth is known."""

from __future__ import annotations

from hypothesis import strategies as st

from fenicsx_obstacle.verification.hard.families import (
    conditions,
    curves,
    discs,
    drifts,
    files,
    films,
    layers,
    residuals,
    rims,
    sectors,
    smooth,
    support,
    supported,
    touching,
    varying,
)
from fenicsx_obstacle.verification.hard.families.family import Family

# u is a closed form, and a bound of the error is compared with the true one
TRUTHS: dict[str, st.SearchStrategy[Family]] = {
    "layers": layers.layers(),
    "layers in contact": layers.layers_in_contact(),
    "waves": layers.waves(),
    "inclusion": curves.inclusions(),
    "pole": curves.poles(),
    "polynomial": smooth.polynomials(),
    "smooth tension": varying.varying(),
    "conditions": conditions.conditions(),
    "rings": discs.rings(),
    "sectors": sectors.sectors(),
    "corner": sectors.corners(),
    "touching": touching.touching(),
    "supported": supported.supported(),
}
KNOWN: dict[str, st.SearchStrategy[Family]] = {
    **TRUTHS,
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
