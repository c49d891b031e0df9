"""The file of a scene folder that says from where the scene was photographed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import what_is
from nw_scenes import limits
from nw_scenes.mesh import rotation_matrix
from nw_scenes.scene import CaptureCameras


def turns(quat: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Return a quaternion w x y z, if it is one.

    Raises:
        ValueError: it is too short to say how anything is turned.
    """
    if sum(part * part for part in quat) * limits.QUAT**2 < 1.0:
        raise ValueError(f"quat {list(quat)} is zero; give w x y z")
    return quat


Component = Annotated[float, Field(ge=-limits.QUAT, le=limits.QUAT)]
Quat = Annotated[tuple[Component, Component, Component, Component], AfterValidator(turns)]
Far = Annotated[float, Field(ge=-limits.MESH_REACH, le=limits.MESH_REACH)]


CameraPose = tuple[Sequence[float], Sequence[float]]
"""Of a camera: position (m, world), and the quaternion, w x y z, that turns its axes, x right, y
down, z ahead, into the world's."""

_FORM = 'it is JSON: {"nw-captures": 1, "cameras": [{"position": [x, y, z], "quat": [w, x, y, z]}]}'


class _CaptureModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _CaptureCamera(_CaptureModel):
    """One camera: x right, y down, z ahead along its optical axis."""

    position: tuple[Far, Far, Far]
    """World, m."""
    quat: Quat
    """What turns the camera's axes into those of the world, w x y z, any length but 0."""


class _CaptureFile(_CaptureModel):
    version: Literal[1] = Field(alias="nw-captures")
    """Version of this format."""
    cameras: tuple[_CaptureCamera, ...] = Field(min_length=1, max_length=limits.CAPTURES)
    """In any order."""


def read_captures(path: Path) -> CaptureCameras:
    """Read the cameras that a scene was photographed with.

    Raises:
        SceneError: the file is missing, too large, or no such file; its first problem is named.
    """
    poses = read_poses(path)
    return CaptureCameras(
        positions=np.array([position for position, _ in poses], dtype=np.float64),
        axes=np.array([rotation_matrix(quat)[:, 2] for _, quat in poses]),
    )


def read_poses(path: Path) -> tuple[CameraPose, ...]:
    """Read the poses of those cameras, in the order of the file.

    Raises:
        SceneError: as `read_captures`.
    """
    try:
        file = _CaptureFile.model_validate_json(_content(path))
    except ValidationError as error:
        raise SceneError(f"{path}: {first_problem(error)}", fix=_FORM) from None
    return tuple((camera.position, camera.quat) for camera in file.cameras)


def first_problem(error: Exception) -> str:
    """Return what a file's first fault is, with its place and value; as one line."""
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"]) or "it"
    problem = f"{clean(place, at_most=80)}: {clean(first['msg'], at_most=200)}"
    if isinstance(first["input"], dict):
        return problem
    return f"{problem} (it is {clean(repr(first['input']), at_most=60)})"


def write_captures(path: Path, cameras: Sequence[CameraPose]) -> None:
    """Write the cameras that a scene was photographed with, whole or not at all.

    Args:
        path: of the file, which a key of scene.yaml names.
        cameras: the pose of each.

    Raises:
        StoreError: it cannot be written.
    """
    content = {
        "nw-captures": 1,
        "cameras": [
            {"position": [*map(float, position)], "quat": [*map(float, quat)]}
            for position, quat in cameras
        ],
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _content(path: Path) -> bytes:
    if what_is(path) != "file":
        raise SceneError(
            f"{path}: there are no capture cameras", fix="check the key `captures` of scene.yaml"
        )
    try:
        with path.open("rb") as stream:
            content = stream.read(limits.CAPTURE_BYTES + 1)
    except OSError as error:
        raise SceneError(
            f"{path} cannot be read: {error.strerror}", fix="check its rights"
        ) from None
    if len(content) > limits.CAPTURE_BYTES:
        raise SceneError(f"{path} is larger than {limits.CAPTURE_BYTES} bytes", fix=_FORM)
    return content
