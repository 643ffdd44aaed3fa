"""Random forms of a user's own, with default options: `python -m tests.random.own_forms COUNT [SEED]`.

Each form is solved by the default penalty method and as a variational inequality. Both are checked from the form
itself: the bounds, the signs of F(u; v_i) at nodes in contact, and the balance elsewhere. What differs by more than
eps = "auto" promises, without a warning or an error, is FAILED.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleError, ObstacleProblem, releases
from fenicsx_obstacle.algebra.penalty_parameter import PENETRATION
from fenicsx_obstacle.parallel import largest, smallest, total

QUICK = {"cffi_extra_compile_args": ["-O0"]}  # most of the time is that of the compiler
BALANCE = 1e-6  # unbalanced over acting forces, computed from the form
CONSTANT = 1e-9  # a range of u below this share of |u| is round-off, or what the stopping test leaves
OPERATORS = (
    "tension", "two materials", "layers", "anisotropic", "porous", "porous without floor", "power law",
    "power law with energy", "film", "exponential", "drift", "reaction", "reaction with energy", "one-sided",
)  # fmt: skip
MESHES = ("interval", "triangle", "triangle", "quadrilateral", "tetrahedron")
SUPPORTS = ("all around", "all around", "left", "Robin", "reaction", "none")
SIDES = ("lower", "upper", "both", "boundary")
PLACES = ("everywhere", "everywhere", "partial", "far")


@dataclass
class Drawn:
    """What was drawn for a form."""

    seed: int
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def one(self, choices: Any) -> Any:
        found = choices[int(self._random.integers(len(choices)))]
        self.words.append(str(found))
        return found

    def number(self, low: float, high: float, name: str) -> float:
        found = float(self._random.uniform(low, high))
        self.words.append(f"{name} {found:.3g}")
        return found

    def size(self, low: float, high: float, name: str) -> float:
        """A number whose logarithm is distributed evenly, between powers of ten."""
        found = float(10.0 ** self._random.uniform(low, high))
        self.words.append(f"{name} {found:.3g}")
        return found

    def flag(self, share: float, name: str) -> bool:
        found = bool(self._random.uniform() < share)
        if found:
            self.words.append(name)
        return found


class OwnForm:
    """A form, its data and its obstacles (collective)."""

    def __init__(self, seed: int, comm: MPI.Comm):
        self.drawn = drawn = Drawn(seed)
        self.mesh = mesh = _mesh(drawn, comm)
        degree = 1 if releases.cell_name(mesh) in ("quadrilateral", "tetrahedron") else drawn.one((1, 1, 2))
        self.V = V = releases.functionspace(mesh, "Lagrange", degree)
        self.u, self.v = fem.Function(V, name="u"), ufl.TestFunction(V)
        self.height = drawn.size(-4, 3, "height")
        self.bump = fem.Function(V)
        dim = mesh.topology.dim
        self.bump.interpolate(lambda x: np.prod(np.sin(np.pi * np.clip(x[:dim], 0, 1)), axis=0))
        self.energy: ufl.Form | None = None
        self._terms()
        self._supports()
        self._load()
        self._obstacles()
        self._start()

    def constant(self, value: float) -> fem.Constant:
        return fem.Constant(self.mesh, PETSc.ScalarType(value))

    def _terms(self) -> None:
        drawn, u, v = self.drawn, self.u, self.v
        number, size, c = drawn.number, drawn.size, self.constant
        grad, h = ufl.grad(u), self.height
        slope = ufl.inner(grad, grad) / c(h) ** 2
        unit = c(size(-6, 6, "unit"))
        kind = self.kind = drawn.one(OPERATORS)
        k, rest, dx = unit, None, ufl.dx(metadata={"quadrature_degree": 4})
        if kind in ("tension", "two materials", "layers", "anisotropic"):
            k = self._tension(kind, unit)
        elif kind in ("porous", "porous without floor"):
            floor, m = (size(-9, -1, "floor"), number(0.5, 4, "m")) if kind == "porous" else (0.0, 2.0)
            k = unit * (c(floor) + abs(u / c(h)) ** c(m))
        elif kind in ("power law", "power law with energy"):
            power = number(1.3, 5, "p")
            floor, p = c(size(-9, -1, "floor")), c(power)
            k = unit * (floor + slope) ** ((p - 2) / 2)
            if kind == "power law with energy":
                self.energy = unit * c(h) ** 2 * (floor + slope) ** (p / 2) / p * dx
        elif kind == "film":
            k = unit / ufl.sqrt(1 + c(size(-1, 0.5, "slope")) * slope)
        elif kind == "exponential":
            k = unit * ufl.exp(c(number(-2, 3, "rate")) * u / c(h))
        elif kind == "one-sided":
            rest = c(size(-1, 4, "spring")) * unit * ufl.max_value(u, 0)
        elif kind in ("reaction", "reaction with energy"):
            spring, m = c(size(-1, 4, "spring")) * unit, 3
            rest = spring * c(h) * (u / c(h)) ** m
            if kind == "reaction with energy":
                self.energy = (0.5 * unit * ufl.inner(grad, grad)) * dx
                self.energy += spring * c(h) ** 2 * (u / c(h)) ** (m + 1) / (m + 1) * dx
        flux = ufl.dot(k, grad) if getattr(k, "ufl_shape", ()) else k * grad
        self.F = ufl.inner(flux, ufl.grad(v)) * dx
        if rest is not None:
            self.F += rest * v * dx
        if kind == "drift":
            self.F += unit * c(size(-1, 1, "drift")) * u.dx(0) * v * dx
        self.unit = float(unit.value)

    def _tension(self, kind: str, unit: fem.Constant) -> Any:
        """A diagonal tensor that is constant in each cell."""
        drawn, scale = self.drawn, fem.Function(releases.functionspace(self.mesh, "DG", 0))
        scale.x.array[:] = 1.0
        if kind == "two materials":
            place, contrast = drawn.number(0.1, 0.9, "place"), drawn.size(-7, 7, "contrast")
            scale.interpolate(lambda x: np.where(x[0] < place, 1.0, contrast))
        elif kind == "layers":
            floor, wave = drawn.size(-5, 0, "floor"), drawn.number(1, 12, "wave")
            scale.interpolate(lambda x: floor + np.cos(wave * x[0]) ** 2)
        n = self.mesh.topology.dim
        ratios = [self.constant(drawn.size(-4, 4, "ratio") if kind == "anisotropic" and k else 1.0) for k in range(n)]
        return unit * scale * ufl.as_matrix([[ratios[i] if i == j else 0.0 for j in range(n)] for i in range(n)])

    def _supports(self) -> None:
        """Dirichlet conditions, or stiffnesses; both terms are in each form, so that few forms are compiled."""
        drawn, V, v, u = self.drawn, self.V, self.v, self.u
        where, dim = drawn.one(SUPPORTS), self.mesh.topology.dim
        self.sides = drawn.one(SIDES)
        if where == "all around" and self.sides == "boundary":
            where = "left"
        self.bcs = []
        if where in ("all around", "left"):
            value = drawn.one((0.0, 0.0, 0.3)) * self.height
            count = dim if where == "all around" else 1

            def edge(x: np.ndarray) -> np.ndarray:
                beside = np.isclose(x[:count], 0).any(axis=0)
                return beside if where == "left" else beside | np.isclose(x[:count], 1).any(axis=0)

            self.bcs = [fem.dirichletbc(PETSc.ScalarType(value), fem.locate_dofs_geometrical(V, edge), V)]
        for name, measure in (("Robin", ufl.ds), ("reaction", ufl.dx)):
            stiff = self.constant(drawn.size(-2, 2, "stiff") * self.unit if where == name else 0.0)
            self.F += stiff * u * v * measure
            if self.energy is not None:
                self.energy += 0.5 * stiff * u**2 * measure

    def _load(self) -> None:
        """A load whose work on a bump of the drawn height is that of the form."""
        drawn, v = self.drawn, self.v
        shapes = {"constant": lambda x: 1.0 + 0 * x[0], "wave": lambda x: np.sin(2 * np.pi * x[0]),
                  "half": lambda x: np.where(x[0] < 0.5 - 1e-9, 1.0, -0.2)}  # fmt: skip
        f = fem.Function(self.V)
        f.interpolate(shapes[drawn.one(tuple(shapes))])
        self.u.x.array[:] = self.height * self.bump.x.array
        forces = self.residual()
        bump = self.bump.x.array[: len(forces)]
        work = total(self.mesh.comm, forces * bump)
        area = total(self.mesh.comm, self.assembled(v * ufl.dx) * bump)
        self.sign = drawn.one((-1, 1))
        f.x.array[:] *= self.sign * drawn.size(-0.5, 2, "load") * work / area
        self.F += -f * v * ufl.dx
        self.load = total(self.mesh.comm, np.abs(self.assembled(f * v * ufl.dx)))
        if self.energy is not None:
            self.energy += -f * self.u * ufl.dx

    def _obstacles(self) -> None:
        drawn, h = self.drawn, self.height
        sides, where = self.sides, drawn.one(PLACES)
        share, tilt, far = drawn.number(0.02, 1.0, "share"), drawn.number(0, 0.5, "tilt"), drawn.one((np.inf, 1e20))
        cut = drawn.number(0.2, 0.8, "cut")
        self.options: dict[str, Any] = {}

        def upper(x: np.ndarray) -> np.ndarray:
            values = h * (share + tilt * x[0] ** 2) + 0.3 * h
            return np.where(x[0] < cut, values, far) if where == "partial" else values

        pressed = ("upper" if self.sign > 0 else "lower") if sides in ("boundary", "far") else sides
        if pressed in ("upper", "both"):
            self.options["upper"] = upper
        if pressed in ("lower", "both"):
            self.options["lower"] = lambda x: -upper(x)
        if where == "far" and pressed != "both":
            other = "lower" if pressed == "upper" else "upper"
            self.options[other] = -far if other == "lower" else far
        if sides == "boundary" and _degree(self) == 1 and self.mesh.topology.dim > 1:
            of_facets = self.mesh.topology.dim - 1
            facets = dmesh.locate_entities_boundary(self.mesh, of_facets, lambda x: np.isclose(x[0], 1))
            facets = np.sort(facets).astype(np.int32)
            tags = dmesh.meshtags(self.mesh, of_facets, facets, np.full(len(facets), 3, dtype=np.int32))
            self.options["measure"] = ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)(3)

    def _start(self) -> None:
        drawn = self.drawn
        kind = drawn.one(("zero", "zero", "small bump", "bump", "large bump"))
        factor = {"zero": 0.0, "small bump": 1e-3, "bump": 1.0, "large bump": 10.0}[kind]
        self.start = factor * self.height * self.sign * self.bump.x.array
        self.u.x.array[:] = self.start

    def assembled(self, form: ufl.Form) -> np.ndarray:
        """A linear form at owned dofs (collective)."""
        with releases.compiled_with(None, QUICK):
            vector = fem.petsc.assemble_vector(releases.form(form))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        found = vector.array_r.copy()
        vector.destroy()
        return found

    def residual(self) -> np.ndarray:
        """F(u; v_i) at owned dofs (collective)."""
        return self.assembled(self.F)

    def problem(self) -> ObstacleProblem:
        self.u.x.array[:] = self.start
        return ObstacleProblem(self.F, self.u, bcs=self.bcs, energy=self.energy, jit_options=QUICK, **self.options)

    def text(self) -> str:
        return f"{self.drawn.seed}: {', '.join(self.drawn.words)}"


def _mesh(drawn: Drawn, comm: MPI.Comm) -> dmesh.Mesh:
    kind = drawn.one(MESHES)
    cells = {"interval": (8, 60), "triangle": (4, 14), "quadrilateral": (4, 14), "tetrahedron": (2, 5)}[kind]
    n = int(drawn.number(*cells, "cells"))
    mode = dmesh.GhostMode.shared_facet
    if kind == "interval":
        mesh = dmesh.create_unit_interval(comm, n, ghost_mode=mode)
    elif kind == "tetrahedron":
        mesh = dmesh.create_unit_cube(comm, n, n, n, ghost_mode=mode)
    else:
        mesh = dmesh.create_unit_square(comm, n, n, getattr(dmesh.CellType, kind), ghost_mode=mode)
    if drawn.flag(0.25, "graded"):
        mesh.geometry.x[:, 0] **= drawn.number(1.2, 2.5, "power")
    return mesh


def attempt(form: OwnForm, **options: Any) -> tuple[Any, str]:
    """A solution, or None and the error; with the warnings (collective)."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            found = form.problem().solve(**options)
        except ObstacleError as error:
            return None, f"{type(error).__name__}: {error}"
    return found, "; ".join(str(one.message) for one in caught if issubclass(one.category, UserWarning))


def judged(form: OwnForm) -> tuple[str, str]:
    """The verdict, and why, in words (collective).

    It is right; loud, where the default solve ends with a warning or an error though the inequality is solved; none,
    where neither is; one, where only the default solve is; FAILED.
    """
    comm = form.mesh.comm
    exact, why_not = attempt(form, method="vi")
    wrong = "" if exact is None else not_in_balance(form, exact, penetrates=False)
    if wrong:
        return "FAILED", f"vi: {wrong}"
    found, words = attempt(form)
    if found is None:
        return "none" if exact is None else "loud", f"{words} | vi: {why_not}" if exact is None else words
    if words := comm.bcast(words):
        return "loud", words
    wrong = not_in_balance(form, found, penetrates=True)
    if wrong:
        return "FAILED", f"penalty: {wrong}"
    if exact is None:
        return "one", why_not
    height = largest(comm, exact.u.x.array) - smallest(comm, exact.u.x.array)
    own = form.V.dofmap.index_map.size_local
    differs = np.abs(found.u.x.array - exact.u.x.array)[:own]
    if _degree(form) == 2:  # at vertices, which no obstacle holds, P2 answers a penetration at midpoints by several
        differs = differs[_is_contact_node(form)]
    apart = largest(comm, differs)
    size = largest(comm, np.abs(exact.u.x.array))
    allowed = 2 * PENETRATION * max(height, CONSTANT * size)
    if not apart <= allowed:  # the stopping test is that of both: a step of Newton shows what it does not see
        moved = _newton_step(form, exact) + _newton_step(form, found)
        if height <= 100 * CONSTANT * size:  # u is constant but for what is left: its range says nothing
            allowed += min(moved, CONSTANT * size)
        elif moved <= allowed and _stays(form, found, allowed, method="vi") and _stays(form, exact, allowed):
            return "right", "two solutions: each method stays at the other's"
    if not apart <= allowed:
        more = f"penetration {found.penetration:.3g}, eps {found.eps:.3g}"
        return "FAILED", f"u differs by {apart:.3g} of {height:.3g}, {more}"
    return "right", ""


def not_in_balance(form: OwnForm, solution: Any, *, penetrates: bool) -> str:
    """What is wrong with a solution, from the form alone (collective)."""
    comm, V = form.mesh.comm, form.V
    form.u.x.array[:] = solution.u.x.array
    own = V.dofmap.index_map.size_local
    forces, u = form.residual(), solution.u.x.array[:own]
    free = np.ones(own, dtype=bool)
    for bc in form.bcs:
        dofs = bc.dof_indices()[0]
        free[dofs[dofs < own]] = False
    given = solution.u.x.array.copy()
    releases.set_values(given, form.bcs)
    if largest(comm, np.abs(solution.u.x.array - given)) > 1e-9 * form.height:
        return "u is not what the Dirichlet condition says"
    at = _is_contact_node(form)
    x = V.tabulate_dof_coordinates().T[:, :own]
    sides = {}
    for name, missing in (("lower", -np.inf), ("upper", np.inf)):
        given = form.options.get(name, missing)
        values = given(x) if callable(given) else np.full(own, given)
        values = np.where(np.abs(values) >= 1e20, missing, values)
        sides[name] = np.where(at & free, values, missing)
    height = largest(comm, u) - smallest(comm, u)
    beyond = max(largest(comm, sides["lower"] - u), largest(comm, u - sides["upper"]), 0.0)
    allowed = (PENETRATION * 1.5 if penetrates else 1e-9) * max(height, CONSTANT * largest(comm, np.abs(u)))
    if not beyond <= allowed:
        return f"u is {beyond:.3g} beyond an obstacle, its range is {height:.3g}"
    near = 1e-9 * max(largest(comm, np.abs(u)), height)
    below, above = u - sides["lower"] <= near, sides["upper"] - u <= near
    unbalanced = np.where(free, np.abs(forces), 0.0)
    unbalanced = np.where(free & below & (forces > 0), 0.0, unbalanced)
    unbalanced = np.where(free & above & (forces < 0), 0.0, unbalanced)
    acting, left = total(comm, np.abs(forces)) + form.load, total(comm, unbalanced)
    if not left <= BALANCE * acting + _round_off(form, forces):
        return f"forces of {left:.3g} are not balanced, of {acting:.3g}"
    return ""


def _stays(form: OwnForm, solution: Any, allowed: float, **options: Any) -> bool:
    """Whether a method that starts at a solution ends there, as where F is not monotone (collective)."""
    before, form.start = form.start, solution.u.x.array.copy()
    again, _ = attempt(form, **options)
    form.start = before
    return again is not None and largest(form.mesh.comm, np.abs(again.u.x.array - solution.u.x.array)) <= allowed


def _newton_step(form: OwnForm, solution: Any) -> float:
    """How far the unbalanced forces of a state move u, with nodes in contact held (collective)."""
    form.u.x.array[:] = solution.u.x.array
    with releases.compiled_with(None, QUICK):
        A = fem.petsc.assemble_matrix(releases.form(ufl.derivative(form.F, form.u)), form.bcs)
    A.assemble()
    x, b = A.createVecs()
    b.array[:] = form.residual()
    fem.petsc.set_bc(b, form.bcs, scale=0.0)
    held = np.flatnonzero(solution.contact.x.array[: len(b.array)] > 0.5)
    b.array[held] = 0.0
    A.zeroRows((held + A.getOwnershipRange()[0]).astype(np.int32), diag=1.0)
    ksp = PETSc.KSP().create(form.mesh.comm)
    ksp.setOperators(A)
    ksp.getPC().setType("lu")
    ksp.setType("preonly")
    ksp.solve(b, x)
    return largest(form.mesh.comm, np.abs(x.array_r))


def _degree(form: OwnForm) -> int:
    return int(form.V.element.basix_element.degree)


def _is_contact_node(form: OwnForm) -> np.ndarray:
    """Whether an owned dof has a weight: for P2 on triangles the midpoints of edges alone (collective)."""
    weights = form.assembled(form.v * form.options.get("measure", ufl.dx))
    return weights > 1e-9 * largest(form.mesh.comm, weights)


def _round_off(form: OwnForm, forces: np.ndarray) -> float:
    """What a change of u in its last digits does to the residual; u is left changed (collective)."""
    u = form.u.x.array
    u *= 1 + 8 * np.finfo(float).eps * np.sin(1e3 * np.arange(len(u)))
    form.u.x.scatter_forward()
    return total(form.mesh.comm, np.abs(form.residual() - forces))


def main(count: int, first: int = 1) -> None:
    """Print a line for each form, and a summary (collective)."""
    comm, words = MPI.COMM_WORLD, Counter[str]()
    for seed in range(first, first + count):
        started = time.perf_counter()
        form = OwnForm(seed, comm)
        word, why = judged(form)
        words[word] += 1
        if comm.rank == 0:
            print(f"{word:7} {time.perf_counter() - started:5.1f} s  {form.text()}  {why}", flush=True)
    if comm.rank == 0:
        print(dict(words))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
