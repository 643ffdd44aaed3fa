"""The levels on which a problem is solved: those of its meshes, and algebraic ones below them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.coarse import SMALLEST, algebraic_levels, below
from fenicsx_obstacle.algebra.coarsening import BOUNDARY, FIXED, FREE, Nodes, first_keys
from fenicsx_obstacle.algebra.kernels import kernels
from fenicsx_obstacle.algebra.linear_solvers import LARGEST
from fenicsx_obstacle.algebra.nested import Levels
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.releases import AMG as PRECONDITIONER
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import corners
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.transfer import downward

NESTED = "conjugate gradients with truncated multigrid; each level starts from the next coarser one"
ALGEBRAIC = "where the mesh has no coarser one levels are algebraic, with interpolation exact for linear functions"
WITHOUT_HYPRE = f"GAMG, and up to {LARGEST} unknowns MUMPS in its place, because this PETSc has no hypre"
AMG = "hypre BoomerAMG" if PRECONDITIONER == "hypre" else WITHOUT_HYPRE
LINEAR_SOLVER = f"conjugate gradients with algebraic multigrid ({AMG})"
GENERAL_SOLVER = f"GMRES with algebraic multigrid ({AMG}), because the equation is not symmetric"
DIRECT_SOLVER = "a direct solver (MUMPS), because contact couples the nodes of a cell"
AUGMENTED = "penalty solves with augmented obstacles g + eps p: the quadratic program with u <= g at the points of I"


def nested(effects: Sequence[Effect], pair: Pair, options: SolverOptions) -> bool:
    """Whether a problem is solved from the coarsest level on: that of its mesh, or an algebraic one below it.

    Truncated multigrid needs stiffness matrices that hold still (affine effects), symmetric and definite, and contact
    at the vertices, or that of P2, which begins with P1 on the same mesh. (3.4)* is the paper's own
    iteration, which starts without contact; `start = "cold"` asks for the same of the other methods. Whatever is not
    nested is solved with `LINEAR_SOLVER`, `GENERAL_SOLVER` or, where the pair is not nodal, `DIRECT_SOLVER`.
    """
    simple = all(effect.affine and effect.symmetric and effect.convex for effect in effects)
    serves = pair.at_vertices or pair.has_p1_coarse_space
    return simple and serves and options.start == "nested" and options.method != "successive"


def stepwise(effects: Sequence[Effect], pair: Pair, options: SolverOptions) -> bool:
    """Whether nested iteration is used although truncated multigrid is not possible, for better initial values.

    Newton's method then has the region of convergence of the coarsest mesh, and few steps on the finest.
    """
    starts = options.start == "nested" and options.method != "successive"
    return starts and pair.nested_hierarchy and not nested(effects, pair, options)


def has_levels(problem: Problem, options: SolverOptions) -> bool:
    """Whether a problem is solved from coarser levels on: by truncated multigrid, or step by step for its starts."""
    effects, pair, moments = problem.model.effects, problem.level.pair, problem.model.time
    if problem.vector_valued or nested(effects, pair, options):
        return True
    at_rest = moments is None or moments.order == EQUILIBRIA  # otherwise the last moment is a better start
    meshes = problem.level.coarse is not None and not problem.data.live
    return at_rest and meshes and stepwise(effects, pair, options)


def levels_of(problem: Problem, options: SolverOptions, *, on_meshes: bool = False) -> Levels:
    """The levels on which a problem is solved, with algebraic ones below the coarsest mesh; the problem alone if there
    are no others (collective).

    Without obstacles BoomerAMG is as good as algebraic levels, where there is hypre.

    Args:
        problem: The problem.
        options: Of its solves.
        on_meshes: Whether the coarse problems are to have meshes and data of their own, to be looked at, instead of
            Galerkin products.
    """
    level, own = problem.level, problem.data.live  # on the caller's mesh and in the caller's space alone
    if not has_levels(problem, options):
        return Levels.of([problem], multigrid=False)
    if problem.vector_valued:
        from fenicsx_obstacle.discrete.vector_levels import coarse_vector_problems  # only where there is a body

        return Levels.of([*coarse_vector_problems(problem), problem], multigrid=False)
    if not nested(problem.model.effects, level.pair, options):
        return Levels.of(mesh_problems(problem), multigrid=False)
    problems = mesh_problems(problem) if on_meshes and not own else [problem]
    if level.pair.has_p1_coarse_space and not on_meshes and not own:
        assert level.coarse is not None
        with suppress(InputError):  # data that only P2 resolves
            problems.insert(0, Problem(Data(problem.model, level.coarse, problem.data.moment)))
    algebraic = own or problem.constrained or PRECONDITIONER != "hypre"
    return Levels.of([*galerkin_systems(problems[0], algebraic=algebraic), *problems], multigrid=True)


def mesh_problems(problem: Problem) -> list[Problem]:
    """The problems from the coarsest mesh to this one; only this one without nested iteration (collective)."""
    problem.__dict__.pop("transfer", None)  # from a coarse problem without a mesh
    problems = [problem]
    for level in problem.level.on_meshes.downward[1:]:
        try:
            data = Data(problem.model, level, problem.data.moment)  # one clock for all levels
            problems.insert(0, Problem(data))
        except InputError:  # data that only the fine levels resolve
            break
    return problems


def galerkin_systems(problem: Problem, *, algebraic: bool = True) -> list[System]:
    """The levels below a problem with affine effects, the coarsest first (collective).

    Those of the meshes that its mesh was refined from, and below them algebraic ones. There are none for few unknowns,
    or where contact is neither at the vertices nor that of P2, which is above P1.

    Args:
        problem: The problem.
        algebraic: Whether to construct algebraic ones.
    """
    level, bottom, found = problem.level, problem.level.downward[-1], list[System]()
    vertices = level.coarse if level.pair.has_p1_coarse_space else level
    assert vertices is not None
    if not vertices.pair.at_vertices:
        return []
    loops = kernels(level.comm) if algebraic and bottom.dofs >= SMALLEST else None
    if loops is None and vertices is bottom:
        return []
    lowest: System = problem
    for transfer in downward(level):
        lowest = below(lowest, transfer)
        found.insert(0, lowest)
    return found if loops is None else [*algebraic_levels(lowest, _nodes(lowest, bottom), loops), *found]


def _nodes(system: System, level: Level) -> Nodes:
    """The nodes of a system that are the vertices of a mesh (collective)."""
    own, dim, gdim = level.owned, level.mesh.topology.dim, level.mesh.geometry.dim
    x = np.ascontiguousarray(level.points.T[:own])
    kind = np.full(own, FREE, dtype=np.int8)
    boundary = fem.locate_dofs_topological(level.V, dim - 1, level.boundary_facets)
    kind[boundary[boundary < own]] = BOUNDARY
    if system.weights_are_sparse:
        kind[system.weights > 0] = BOUNDARY
    kind[system.fixed] = FIXED
    tangents = None if dim == gdim else _tangents(level)
    return Nodes(x, kind, first_keys(system.matrices.stiffness, x), tangents, dim)


def _tangents(level: Level) -> np.ndarray:
    """Orthonormal bases of tangent spaces at owned nodes, by the cells around, shape (nodes, dim, 3) (collective)."""
    V, vertices, dim = level.V, corners(level.mesh), level.mesh.topology.dim
    own = level.mesh.topology.index_map(dim).size_local
    dofs, edges = releases.cell_dofs(V)[:own], vertices[:own, 1:] - vertices[:own, :1]
    spread = np.einsum("cei,cej->cij", edges, edges)
    around, moments = AroundNodes(V, dofs), np.empty((level.owned, 3, 3))
    for i in range(3):
        for j in range(i + 1):
            values = np.repeat(spread[:, i, j], dofs.shape[1])
            moments[:, i, j] = moments[:, j, i] = around.sums(values)[: level.owned]
    return np.ascontiguousarray(np.linalg.eigh(moments)[1].transpose(0, 2, 1)[:, 3 - dim :])
