"""Opening a scene folder for labelling, without compiling its terrain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.yaml_file import YamlProblems, read_yaml
from nw_eval.scenes.capture_file import CameraPose, read_poses
from nw_eval.scenes.folder import SCENE_FILE, folder_files, load_folder
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.mesh_file import MESH_SUFFIXES, read_mesh
from nw_eval.twin.label.state import LabelState, Placement, StartPose, as_point


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenedPlace:
    """A scene folder as it was opened.

    Attributes:
        folder: that holds scene.yaml.
        name: of the scene.
        collision: the collision file's name in the folder.
        splat: of its looks; None = it has none.
        mesh: what can be touched; world, m.
        is_scan: whether the mesh is the collision file, not boxes: only then it can be moved.
        T_world_splat: (4, 4) similarity.
        captures: name of the file of the cameras that photographed it; None = nobody says.
        cameras: those, in the order of the file; world.
        state: what scene.yaml says of the course.
    """

    folder: Path
    name: str
    collision: str
    splat: Path | None
    mesh: TriangleMesh
    is_scan: bool
    T_world_splat: NDArray[np.float64]
    captures: str | None
    cameras: tuple[CameraPose, ...]
    state: LabelState

    @property
    def walk(self) -> NDArray[np.float64]:
        """Where the cameras stood, (N, 3), m, in order."""
        return np.array([position for position, _ in self.cameras], dtype=float).reshape(-1, 3)


def open_place(folder: Path) -> OpenedPlace:
    """Read a scene folder.

    Raises:
        SceneError: a file is missing or wrong; every problem with file and line.
    """
    files = folder_files(folder)  # Checks all of scene.yaml.
    try:
        text = read_yaml(folder / SCENE_FILE).data
    except YamlProblems as error:  # It was changed just now.
        raise SceneError(error.problems) from None
    collision = str(text.get("collision", "collision.yaml"))
    splat, captures = text.get("splat"), text.get("captures")
    is_scan = files[collision].suffix.lower() in MESH_SUFFIXES
    spawn = text.get("spawn", {})
    return OpenedPlace(
        folder=folder,
        name=str(text["name"]),
        collision=collision,
        splat=files[splat] if splat is not None else None,
        mesh=read_mesh(files[collision]) if is_scan else _boxes_of(folder),
        is_scan=is_scan,
        T_world_splat=Placement(**text.get("T_world_splat", {})).matrix,
        captures=captures,
        cameras=read_poses(files[captures]) if captures is not None else (),
        state=LabelState(
            to_scale=text.get("units", "m") == "m",
            task=text["task"],
            waypoints=tuple(as_point(np.array(point, dtype=float)) for point in text["trail"]),
            start=StartPose(
                position=as_point(np.array(spawn.get("position", (0.0, 0.0, 0.0)), dtype=float)),
                yaw=float(spawn.get("yaw", 0.0)),
            ),
        ),
    )


def _boxes_of(folder: Path) -> TriangleMesh:
    return load_folder(folder, needs_scale=False).static_mesh
