"""From the [mesh] table of a scene to its mesh: a shape, a file, or the caller's own."""

from __future__ import annotations

from math import inf

from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES, Pair
from fenicsx_obstacle.mesh import files, shapes
from fenicsx_obstacle.mesh.checks import check_degree
from fenicsx_obstacle.mesh.levels import Level, halves_at_once, of_mesh, of_pair, refined
from fenicsx_obstacle.mesh.memory import check_memory
from fenicsx_obstacle.scenes.definitions import Definitions, pair_of


def build(scene: Definitions, comm: MPI.Comm, unknowns: float = inf) -> Level:
    """The scene's mesh, refined as often as it says (collective).

    A shape begins with a coarser grid where that leads to the same vertices: the levels below serve multigrid.

    Args:
        scene: With the mesh.
        comm: Communicator; not used if the scene has a DOLFINx mesh.
        unknowns: A level that has so many is not refined: with 0 the mesh is the coarsest one.

    Raises:
        InputError: If the mesh needs more memory than there is, or its file cannot be read.
    """
    level, refine, pair = _begin(scene, comm)
    dim = level.mesh.topology.dim
    while refine and level.dofs * pair.degree**dim < unknowns:
        times = refine if unknowns == inf and halves_at_once(level) else 1
        finer = level.dofs * (2.0**times * pair.degree) ** dim
        check_memory(finer, dim, level.comm, scene.source, "'refine' fewer times")
        level, refine = refined(level, times), refine - times
    return of_pair(level, pair)


def same(one: Definitions, other: Definitions) -> bool:
    """Whether two scenes have the same mesh and element: they differ in data only."""
    if one.tables.mesh != other.tables.mesh or one.own_mesh is not other.own_mesh or one.pair is not other.pair:
        return False
    if one.tables.mesh.shape is None:
        return one.folder == other.folder
    ends = [(shape.lower, shape.upper) for shape in map(shape_of, (one, other))]  # formulas may be in [mesh]
    return ends[0] == ends[1]


def _begin(scene: Definitions, comm: MPI.Comm) -> tuple[Level, int, Pair]:
    """The coarsest level, how often to refine it, and the element."""
    table, pair = scene.tables.mesh, scene.pair
    refine = table.refine
    if (own := scene.own_mesh) is not None:
        level = of_mesh(releases.settle(own.mesh), scene.source, own.facets, own.cells)
    elif table.file is not None:
        level = files.read(scene.folder / table.file, comm)
        pair = pair_of(scene.tables, scene.source, releases.cell_name(level.mesh))
    else:
        shape = shape_of(scene)
        dim = len(shape.cells)
        unknowns = shape.vertices(2.0**refine * pair.degree)
        check_memory(unknowns, dim, comm, scene.source, "'refine' fewer times" if refine else "take fewer 'cells'")
        mesh, sides, h, halvings = shapes.coarsest_grid(shape, comm)
        level, refine = Level(mesh, h, sides, shape=shape), refine + halvings
    check_degree(level.mesh, scene.source if table.file is None else str(scene.folder / table.file), 1 + scene.of_body)
    cell = releases.cell_name(level.mesh)
    try:  # contact of elastic bodies has the rules of facets
        pair.rule("triangle" if scene.of_body and cell == "tetrahedron" else cell)
    except InputError as error:
        raise InputError(f"{scene.source}: [solve] {error}") from None
    if refine and cell not in SIMPLICES:
        finer = "smaller cells in the file" if level.shape is None else "more 'cells'"
        raise InputError(f"{scene.source}: [mesh] refine is for simplices; take {finer}")
    if refine and releases.geometry_degree(level.mesh) > 1:
        raise InputError(f"{scene.source}: [mesh] refine is for straight cells, of degree 1; take smaller cells")
    return level, refine, pair


def shape_of(scene: Definitions) -> shapes.Shape:
    """The shape that [mesh] names.

    Raises:
        InputError: If its corners or its radius make no domain, or it has no cells of the kind asked for.
    """
    name = scene.tables.mesh.shape
    assert name is not None
    return shapes.SHAPES[name].make(_Measures(scene))


class _Measures:
    """What the [mesh] table of a scene says of its shape."""

    def __init__(self, scene: Definitions):
        self.scene, self.table = scene, scene.tables.mesh
        self.cells, self.diagonal, self.perturb = self.table.cells, self.table.diagonal, self.table.perturb

    def side(self, axis: str) -> tuple[float, float]:
        a, b = (self.scene.number(value, f"[mesh] {axis}") for value in getattr(self.table, axis))
        place = f"{self.scene.source}: [mesh] {axis} = [{a:g}, {b:g}]"
        if not a < b:
            raise InputError(f"{place}: the first end must be less than the second")
        if not max(1e-14, 1e-13 * max(abs(a), abs(b))) < b - a < 1e150:
            raise InputError(f"{place}: too close or too far for floating point; choose another unit or origin")
        return a, b

    def positive(self, key: str) -> float:
        number = self.scene.number(getattr(self.table, key), f"[mesh] {key}")
        if number <= 0:
            raise InputError(f"{self.scene.source}: [mesh] {key} = {number:g}: must be positive")
        return number

    def cell(self, *kinds: str) -> str:
        """The kind that the table names, or else the first of these that the pair is for."""
        asked = self.table.cell
        if asked is None:
            return next((kind for kind in kinds if kind in self.scene.pair.rules), kinds[0])
        if asked not in kinds:
            wanted = f"this shape has {' or '.join(kinds)} cells"
            raise InputError(f"{self.scene.source}: [mesh] cell = '{asked}': {wanted}")
        return asked
