"""Fields as ParaView opens them: HDF5 for the numbers, XDMF to say what they are."""

from __future__ import annotations

from collections.abc import Mapping

import h5py
import numpy as np

from fenicsx_obstacle.io.rows import Rows

Array = np.ndarray | Rows  # XDMF has its shape and type
BY_CELL = ("von_mises",)  # fields with one value for each cell
FRAMES = ("frames.h5", "frames.xdmf")  # the fields at the moments of a scene with [time]
SIMPLEX = {2: "interval", 3: "triangle", 4: "tetrahedron"}  # by vertices
_TOPOLOGY = {
    "interval": "Polyline", "triangle": "Triangle", "tetrahedron": "Tetrahedron",
    "quadrilateral": "Quadrilateral", "hexahedron": "Hexahedron",
}  # fmt: skip


def to_hdf5(arrays: Mapping[str, np.ndarray]) -> bytes:
    """An HDF5 file; made in memory, since the library ends the process where a disk is full."""
    with h5py.File("fields.h5", "w", driver="core", backing_store=False) as file:
        for name, values in arrays.items():
            file[name] = values
        file.flush()
        return bytes(file.id.get_file_image())


def xdmf(mesh: Mapping[str, Array], moments: Mapping[float | None, Mapping[str, Array]]) -> str:
    """One grid with all fields on it, so that ParaView shows them together; or one for each moment.

    Args:
        mesh: `points` and `cells`, which fields.h5 holds.
        moments: Fields at each moment, of frames.h5; or those of fields.h5 at None.
    """
    points, cells = mesh["points"], mesh["cells"]
    ground = _mesh("fields.h5", points, cells, SIMPLEX[cells.shape[1]])
    grids = ""
    for number, (t, fields) in enumerate(moments.items()):
        place = "fields.h5:/" if t is None else f"frames.h5:/{number:04d}/"
        clock = f'<Time Value="{0.0 if t is None else t!r}"/>\n'  # readers ask for one, also of what is at rest
        attributes = "".join(
            _attribute(name, values, place) for name, values in fields.items() if name not in ("points", "cells")
        )
        grids += f'<Grid Name="answer" GridType="Uniform">\n{clock}{ground}{attributes}</Grid>\n'
    if None not in moments:
        grids = f'<Grid Name="course" GridType="Collection" CollectionType="Temporal">\n{grids}</Grid>\n'
    return _document(grids)


def xdmf_mesh(file: str, points: np.ndarray, cells: np.ndarray, cell: str) -> str:
    """A mesh alone, whose points, shape (n, gdim), and cells, in the order of VTK, an HDF5 file holds."""
    return _document(f'<Grid Name="mesh" GridType="Uniform">\n{_mesh(file, points, cells, cell)}</Grid>\n')


def _document(grids: str) -> str:
    return f'<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n{grids}</Domain></Xdmf>\n'


def _attribute(name: str, values: Array, place: str) -> str:
    kind, centre = "Scalar" if len(values.shape) == 1 else "Vector", "Cell" if name in BY_CELL else "Node"
    return (
        f'<Attribute Name="{name}" AttributeType="{kind}" Center="{centre}"><DataItem '
        f'Dimensions="{" ".join(map(str, values.shape))}" NumberType="Float" Precision="{values.dtype.itemsize}" '
        f'Format="HDF">{place}{name}</DataItem></Attribute>\n'
    )


def _mesh(file: str, points: Array, cells: Array, cell: str) -> str:
    shape, (count, gdim) = " ".join(map(str, cells.shape)), points.shape
    return (
        f'<Topology TopologyType="{_TOPOLOGY[cell]}" NumberOfElements="{cells.shape[0]}" '
        f'NodesPerElement="{cells.shape[1]}"><DataItem Dimensions="{shape}" NumberType="Int" '
        f'Precision="{cells.dtype.itemsize}" '
        f'Format="HDF">{file}:/cells</DataItem></Topology>\n'
        f'<Geometry GeometryType="{"XYZ"[:gdim]}"><DataItem Dimensions="{count} {gdim}" NumberType="Float" '
        f'Precision="8" Format="HDF">{file}:/points</DataItem></Geometry>\n'
    )
