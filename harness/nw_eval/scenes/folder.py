"""Scene folders: `scene.yaml` beside a collision file and a splat."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_eval.errors import SceneError
from nw_eval.scenes.mesh import TriangleMesh, box_mesh, merge, quad_mesh, rotation_matrix
from nw_eval.scenes.scene import Box, Plane, Progress, Scene, Solid, Spawn, Task
from nw_eval.scenes.terrain.mesh_file import MESH_SUFFIXES, read_mesh
from nw_eval.scenes.terrain.options import Collision, TerrainOptions
from nw_eval.yaml_file import YamlFile, YamlProblems, read_yaml, validation_problems

SCENE_FILE = "scene.yaml"
_MESH_SUFFIXES = (".obj", ".stl", ".ply")
_GROUND_REACH = 60.0

_Read = TypeVar("_Read", bound=BaseModel)

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class _Model(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )


class _Box(_Model):
    """One solid box; see `nw_eval.scenes.Box`."""

    center: Triple
    half_size: Triple
    quat: Quadruple = (1.0, 0.0, 0.0, 0.0)
    friction: Triple = (1.25, 0.3, 0.3)
    material: str = ""
    kind: Literal["obstacle", "structure", "clutter"] = "obstacle"

    @model_validator(mode="after")
    def _check(self) -> _Box:
        if min(self.half_size) <= 0:
            raise ValueError("half_size must be positive; half of the length along each own axis")
        if sum(part * part for part in self.quat) < 1e-12:
            raise ValueError("quat is zero; give w x y z")
        return self


class _Collision(_Model):
    """The collision file."""

    boxes: tuple[_Box, ...]


class _Spawn(_Model):
    position: Triple = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    x_jitter: float = Field(default=0.1, ge=0)
    y_jitter: float = Field(default=0.1, ge=0)
    yaw_jitter: float = Field(default=0.1, ge=0)


class _Similarity(_Model):
    """What maps splat points to world metres: scale, then rotation, then translation."""

    scale: float = Field(default=1.0, gt=0)
    quat: Quadruple = (1.0, 0.0, 0.0, 0.0)
    translation: Triple = (0.0, 0.0, 0.0)

    def matrix(self) -> NDArray[np.float64]:
        transform = np.eye(4)
        transform[:3, :3] = self.scale * rotation_matrix(self.quat)
        transform[:3, 3] = self.translation
        return transform


class _SceneFile(_Model):
    """The keys of `scene.yaml`."""

    version: Literal[1] = Field(alias="nw-scene")
    name: str = Field(min_length=1)
    task: Task
    title: str = ""
    licence: str
    units: Literal["m"] = "m"
    trail: tuple[Triple, ...] = Field(min_length=1)
    spawn: _Spawn = _Spawn()
    waypoint_noise: tuple[float, float] = (0.0, 0.1)
    ground: float = 0.0
    collision: str = "collision.yaml"
    splat: str | None = None
    T_world_splat: _Similarity = _Similarity()


@dataclass(frozen=True, kw_only=True)
class FileSplat:
    """Gaussians read from a splat file."""

    path: Path

    @property
    def key(self) -> str:
        """Hex SHA-256 of the file.

        Raises:
            SceneError: the file cannot be read.
        """
        return self._key

    @cached_property
    def _key(self) -> str:
        try:
            with self.path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise SceneError(
                f"{self.path}: the splat cannot be read: {error.strerror}",
                fix="check the key `splat` of scene.yaml",
            ) from None

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store in the cache."""
        from nw_eval.splat.store import compiled_store

        if progress is not None:
            progress("read", 0.0)
        path = compiled_store(self.path, self.key)
        if progress is not None:
            progress("stored", 1.0)
        return path


def load_folder(folder: Path, *, collision: Collision = "terrain") -> Scene:
    """Return the scene of a folder.

    A collision mesh becomes terrain: height fields and boxes, or with `flex` its own triangles.

    Raises:
        SceneError: a file is missing or wrong; every problem found, with file and line.
    """
    text = _read(folder / SCENE_FILE, _SceneFile)
    trail = np.array(text.trail, dtype=np.float64)
    path = folder / text.collision
    solids: tuple[Solid, ...]
    if path.suffix.lower() in MESH_SUFFIXES:
        # Embree loads with it; listing scenes needs neither.
        from nw_eval.scenes.terrain.store import compiled_terrain

        static_mesh = read_mesh(path)
        terrain = compiled_terrain(
            static_mesh,
            trail=trail,
            spawn=np.array(text.spawn.position, dtype=np.float64),
            options=TerrainOptions(collision=collision),
        )
        solids, ground = terrain.solids, Plane(z=terrain.floor)
    else:
        boxes = _boxes(path)
        static_mesh = solids_mesh(boxes, text.ground)
        solids, ground = boxes, Plane(z=text.ground)
    splat = None if text.splat is None else FileSplat(path=folder / text.splat)
    if splat is not None and not splat.path.is_file():
        raise SceneError(
            f"{folder / SCENE_FILE}: there is no splat {text.splat!r} beside it",
            fix="check the key `splat`",
        )
    return Scene(
        name=text.name,
        task=text.task,
        title=text.title or text.name,
        solids=solids,
        ground=ground,
        trail=trail,
        static_mesh=static_mesh,
        splat=splat,
        spawn=Spawn(**text.spawn.model_dump()),
        waypoint_noise=text.waypoint_noise,
        T_world_splat=text.T_world_splat.matrix(),
        licence=text.licence,
    )


def solids_mesh(boxes: tuple[Box, ...], ground: float) -> TriangleMesh:
    """Return the ground's quad and the faces of boxes."""
    reach = _GROUND_REACH
    quad = quad_mesh((-reach, -reach, ground), (2 * reach, 0, 0), (0, 2 * reach, 0), "ground")
    return merge([quad, *(box_mesh(b.center, b.half_size, b.quat, b.kind) for b in boxes)])


def _boxes(path: Path) -> tuple[Box, ...]:
    return tuple(Box(**box.model_dump()) for box in _read(path, _Collision).boxes)


def _read(path: Path, model: type[_Read]) -> _Read:
    try:
        file: YamlFile = read_yaml(path)  # JSON is YAML too.
    except YamlProblems as error:
        raise SceneError(str(error)) from None
    data: dict[str, Any] = file.data
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = validation_problems(error, file, model)
        raise SceneError("\n".join(map(str, problems))) from None
