"""The solution of a scene, frozen."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.problems.solution import Files, Solution
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.text import one_line

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.time_history import TimeHistory
    from fenicsx_obstacle.check.verification import Verification
    from fenicsx_obstacle.data.data import Data
    from fenicsx_obstacle.fields.contact_table import ContactTable
    from fenicsx_obstacle.io.rows import Rows

NEWTON = "newton.csv"  # the last moment's iteration, where history.csv is the course of time


@dataclass(frozen=True, eq=False, repr=False)
class Answer(Solution):
    """A solution of a scene. It has all attributes and methods of `Solution`.

    Attributes:
        scene: The scene, with the changes made by arguments of `solve`.
        time_history: All time steps, for a scene with [time]; otherwise None. `u`, `pressure` and the other fields are
            those at the final time.
    """

    scene: Scene = field(kw_only=True)
    time_history: TimeHistory | None = None

    @property
    def error(self) -> fem.Function | None:
        """Difference from the exact solution at the nodes; None if the exact solution is not known."""
        return self.fields.error

    @property
    def symbol(self) -> str:
        return self.scene.tables.u

    @cached_property
    def shown(self) -> Self:
        """What pictures show; of a body in time the moment of the largest contact force, as the load may end at zero.

        Its title says which moment. An earlier moment than the last is on P1 simplices (first use is collective).
        """
        time = self.record.get("time")
        if time is None or self.time_history is None or not self.scene.model.vector_valued:
            return self
        from fenicsx_obstacle.fields.vector import VectorFields  # no scalar solution needs it

        assert isinstance(self.fields, VectorFields)
        t, fields = time.get("largest", time["t"]), self.fields  # folders of version 0.2 do not have it
        frames = [frame for frame in self.time_history.frames if frame.t == t]
        if t != time["t"] and frames:
            fields, time = fields.plain.with_values(self.level.comm.bcast(frames[0].fields)), {**time, "t": t}
        title = f"{self.title}, {one_line(time['name'])} = {time['t']:.4g}"
        return replace(self, fields=fields, record={**self.record, "title": title, "time": time})

    def verify(self) -> Verification:
        """As that of `Solution`, with the scene's data on the mesh of the answer (collective).

        Raises:
            InputError: For a scene with [time].
        """
        scene = self.scene
        if scene.time is not None:
            raise InputError(f"{scene.source}: [time]: verify checks equilibria, not steps in time")
        if scene.model.vector_valued:  # late imports: only if requested
            from fenicsx_obstacle.mesh.levels import with_parts
            from fenicsx_obstacle.scenes.bodies import Body

            return Body(scene.model, with_parts(self.level.scalar, self.level)).verify(self)
        from fenicsx_obstacle.check.verification import verify
        from fenicsx_obstacle.discrete.problem import Problem

        problem = Problem(self.data())
        if self.bound is not None:
            from fenicsx_obstacle.estimation.bound import Estimator

            Estimator(problem).set_load(resolved=True)
        return verify(problem, self)

    def data(self) -> Data:
        """The scene's data on the mesh of the answer; with [time] those at the end."""
        from fenicsx_obstacle.data.data import Data  # only if requested

        data = Data(self.scene.model, self.level)
        if data.moment is not None:
            data.moment.t = self.record["time"]["t"]
        return data

    def files(
        self, folder: Path, mesh: Mapping[str, Rows], element: Mapping[str, Rows], parts: Mapping[str, np.ndarray]
    ) -> Files:
        from fenicsx_obstacle.io.element import own_mesh
        from fenicsx_obstacle.io.folder import NODES

        text, data = self._scene_in(folder).with_data()
        contents = {"scene.toml": text.encode(), **data}
        if element and self.scene.mesh is not None:
            contents |= own_mesh(self.level, mesh["points"], element["cells"], parts)
        if self.time_history is not None:
            from fenicsx_obstacle.io.folder import history_csv

            contents |= {NEWTON: history_csv(self.history), **self.time_history.files(mesh)}
        if self.scene.model.vector_valued:
            contents[NODES] = _nodes_csv(self.nodes)
        return contents

    def _scene_in(self, folder: Path) -> Scene:
        """The scene as it can be read from its folder: a mesh of the caller's own is the one in fields.xdmf."""
        from fenicsx_obstacle.io.element import OWN_MESH

        scene, file = self.scene, self.scene.tables.mesh.file
        if scene.mesh is not None:
            return scene.with_mesh_file("fields.xdmf" if scene.pair.nested_hierarchy else OWN_MESH[0])
        if file is None:
            return scene
        return scene.change({"mesh.file": os.path.relpath((scene.folder / file).resolve(), folder.resolve())})

    @cached_property
    def _known_tension(self) -> Any:
        """The tension in UFL; of a read answer that of its scene, at the last moment (first use is collective)."""
        if self.tension is not None:
            return self.tension
        return self.scene.model.elastic.tension_at(self.u, self.data())

    @classmethod
    @checked()
    def read(cls, folder: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Answer:
        """A saved answer with the element it was computed with, on any number of ranks (collective).

        Args:
            folder: A folder of `save`.
            comm: The ranks that share its mesh.

        Raises:
            InputError: If the folder has no saved solution.
        """
        from fenicsx_obstacle.io.folder import gather, read

        folder = Path(folder)
        saved = read(folder, comm, needed=("scene.toml",), steps_in_time=NEWTON)
        scene = Scene.read(folder / "scene.toml")
        answer = cls(saved.fields, saved.history, saved.record, saved.bound, scene=scene)
        if "time" not in answer.record:
            return answer
        from fenicsx_obstacle.answers.time_history import TimeHistory  # only where a scene has time

        time_history = on_root(comm, lambda: TimeHistory.read(folder, len(saved.mesh["points"])))
        return replace(answer, time_history=time_history.renumbered(saved.mesh, gather(answer.fields)))


def _nodes_csv(nodes: ContactTable) -> bytes:
    """The contact nodes, a line each."""
    text, axes = StringIO(), "xyz"[: nodes.points.shape[1]]
    heads = [*axes, *(f"n_{axis}" for axis in axes), "area", "p", "gap"]
    columns = np.column_stack([nodes.points, nodes.normals, nodes.areas, nodes.pressure, nodes.gap])
    np.savetxt(text, columns, fmt="%.12g", delimiter=",", header=",".join(heads), comments="")
    return text.getvalue().encode()
