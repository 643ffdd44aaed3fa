"""The solution of a scene, frozen."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.problems.solution import Files, Solution
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.signatures import checked

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.time_history import TimeHistory
    from fenicsx_obstacle.io.rows import Rows

NEWTON = "newton.csv"  # the last moment's iteration, where history.csv is the course of time


@dataclass(frozen=True, eq=False, repr=False)
class Answer(Solution):
    """A solution of a scene. It has all attributes and methods of `Solution`.

    Attributes:
        scene: The scene, with the changes made by arguments of `solve`.
        error: Difference from the exact solution at the nodes; None if the exact solution is not known.
        time_history: All time steps, for a scene with [time]; otherwise None. `u`, `pressure` and the other fields are
            those at the final time.
    """

    scene: Scene = field(kw_only=True)
    error: fem.Function | None = None
    time_history: TimeHistory | None = None

    @property
    def symbol(self) -> str:
        return self.scene.tables.u

    def functions(self) -> dict[str, fem.Function]:
        return super().functions() | ({} if self.error is None else {"error": self.error})

    def files(
        self, folder: Path, mesh: Mapping[str, Rows], element: Mapping[str, Rows], parts: Mapping[str, np.ndarray]
    ) -> Files:
        from fenicsx_obstacle.io.element import own_mesh

        text, data = self._scene_in(folder).with_data()
        contents = {"scene.toml": text.encode(), **data}
        if element and self.scene.mesh is not None:
            contents |= own_mesh(self.level, mesh["points"], element["cells"], parts)
        if self.time_history is not None:
            from fenicsx_obstacle.io.folder import history_csv

            contents |= {NEWTON: history_csv(self.history), **self.time_history.files(mesh)}
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
    def _tension(self) -> Any:
        """The tension in UFL; of a read answer that of its scene, at the last moment (first use is collective).

        Raises:
            InputError: If the scene does not say it, as it was given in Python.
        """
        if self.tension is not None:
            return self.tension
        from fenicsx_obstacle.discrete.data import Data  # only if requested
        from fenicsx_obstacle.discrete.time_discretization import Moment

        time = self.record.get("time")
        data = Data(self.scene.model, self.level, None if time is None else Moment(time["t"], 0.0, 0.0))
        tension = data.model.elastic.tension_at(self.u, data)
        return super()._tension if tension is None else tension

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
        if "nodes" in saved.fields:
            from fenicsx_obstacle.answers.bodies import BodyAnswer  # no scalar solution needs it
            from fenicsx_obstacle.problems.vector_valued import saved as body

            answer: Answer = BodyAnswer.of(body(saved.fields), scene)
        else:
            answer = cls(**saved.fields, scene=scene)
        if "time" not in answer.record:
            return answer
        from fenicsx_obstacle.answers.time_history import TimeHistory  # only where a scene has time

        time_history = on_root(comm, lambda: TimeHistory.read(folder, len(saved.mesh["points"])))
        return replace(answer, time_history=time_history.renumbered(saved.mesh, gather(answer)))
