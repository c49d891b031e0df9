"""A capture: photographs without distortion, where each was taken from, and points they share.

It is what `calibrate` leaves and every later stage reads: capture.json, points.npz, and pictures
beside them.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from nw_base.errors import SceneError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import OutsideError, inside, regular
from nw_base.files.pictures import open_picture
from nw_scenes.capture_file import first_problem
from nw_splat.camera import Camera
from nw_twin.lens import Lens

_JSON, _POINTS = "capture.json", "points.npz"
_MOST_BYTES = 64 * 2**20
"""Of a capture.json that is read."""
MOST_DISTANT = 1e12
"""Of a coordinate of a point, in the capture's unit: triangulation leaves some far behind."""
FARTHEST = 1e9
"""Of a camera's place, in the capture's unit: squares of it stay exact enough."""
_TURN = 1e-3
"""That a rotation's columns may be off unit length and right angles."""
_MOST_PIXELS = 100_000_000
"""Of a picture that is read."""
_DAMAGE = (
    *(OSError, ValueError, LookupError, TypeError, EOFError, MemoryError),
    *(BadZipFile, zlib.error, RuntimeError, SyntaxError, Image.DecompressionBombError),
)
"""What NumPy and Pillow raise at damaged files; RuntimeError at zips that claim a password."""
_KINDS = {
    "points": np.float64,
    "colours": np.uint8,
    "errors": np.float32,
    "seen": np.int32,
    "firsts": np.int64,
}
"""Arrays of points.npz."""
_FIX = "calibrate again: `nw-eval twin calibrate`"


@dataclass(frozen=True, kw_only=True)
class PlacedShot:
    """One photograph of a capture.

    Attributes:
        name: of the photograph that was taken, e.g. `IMG_0012.jpg`.
        file: of the picture without distortion, relative to the capture's folder.
        camera: in the capture's frame.
        seen: (K,) int32, sorted: numbers of the points that it shows.
        mask: file of its mask, (H, W) where 0 is no part of the scene; None without.
        lens: through which the photograph was taken; None if unknown, and then the pixels of
            a photograph are those of its picture.
    """

    name: str
    file: str
    camera: Camera
    seen: NDArray[np.int32]
    mask: str | None = None
    lens: Lens | None = None

    @property
    def photographed(self) -> tuple[int, int]:
        """Width and height of the photograph as it was taken, pixels."""
        shape = self.camera if self.lens is None else self.lens
        return shape.width, shape.height


@dataclass(frozen=True, kw_only=True)
class Capture:
    """Shots and sparse points in one frame: any rotation, any scale, until it is aligned.

    Attributes:
        shots: in the order of their names.
        points: (N, 3) float64.
        colours: (N, 3) uint8.
        errors: (N,) float32, mean reprojection error of each point, pixels.
        metric: whether the frame's unit is the metre, as its source says.
        up: (3,) unit vector in this frame, as its source says; None where it does not.
    """

    shots: tuple[PlacedShot, ...]
    points: NDArray[np.float64]
    colours: NDArray[np.uint8]
    errors: NDArray[np.float32]
    metric: bool = False
    up: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check that all of it fits together; SceneError says what cannot be."""
        n = len(self.points)
        shapes = (self.points.shape, self.colours.shape, self.errors.shape)
        if shapes != ((n, 3), (n, 3), (n,)) or not (np.abs(self.points) <= MOST_DISTANT).all():
            raise SceneError(
                f"a capture's points, colours and errors have the shapes {shapes}, or points are "
                f"not finite, or beyond {MOST_DISTANT:g}",
                fix="calibrate again",
            )
        if self.up is not None and not 0.999 < np.linalg.norm(self.up) < 1.001:
            raise SceneError(f"a capture's up is {self.up}, no unit vector", fix="calibrate again")
        names = [shot.name for shot in self.shots]
        if len(set(names)) < len(names):
            raise SceneError("two shots of a capture have one name", fix="calibrate again")
        for shot in self.shots:
            if len(shot.seen) and not 0 <= shot.seen.min() <= shot.seen.max() < n:
                raise SceneError(
                    f"{shot.name} shows point {shot.seen.max()} of {n}", fix="calibrate again"
                )

    @property
    def centres(self) -> NDArray[np.float64]:
        """Where each shot was taken from, (shots, 3)."""
        return np.array([shot.camera.T_world_camera[:3, 3] for shot in self.shots]).reshape(-1, 3)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


_Focal = Annotated[float, Field(gt=0, le=1e6)]
_Place = Annotated[float, Field(ge=-1e6, le=1e6)]
_Far = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
_Row = tuple[_Far, _Far, _Far, _Far]


def _is_last(row: _Row) -> _Row:
    if row != (0, 0, 0, 1):
        raise ValueError("the last row of a pose is 0 0 0 1")
    return row


class _Lens(_Model):
    model: str
    width: int
    height: int
    params: tuple[FiniteFloat, ...]


class _Shot(_Model):
    lens: _Lens | None = None
    name: str
    file: str
    mask: str | None = None
    width: int
    height: int
    fx: _Focal
    fy: _Focal
    cx: _Place
    cy: _Place
    T_world_camera: tuple[_Row, _Row, _Row, Annotated[_Row, AfterValidator(_is_last)]]


class _File(_Model):
    version: int = Field(alias="nw-capture", default=1, ge=1, le=1)
    metric: bool = False
    up: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    shots: tuple[_Shot, ...]


@dataclass(frozen=True)
class _Lists:
    """Lists of numbers as one array and where each begins."""

    numbers: NDArray[np.int32]
    firsts: NDArray[np.int64]

    @classmethod
    def of(cls, lists: list[NDArray[np.int32]]) -> _Lists:
        firsts = np.cumsum([0, *map(len, lists)], dtype=np.int64)
        return cls(np.concatenate([np.zeros(0, np.int32), *lists]).astype(np.int32), firsts)

    def __getitem__(self, index: int) -> NDArray[np.int32]:
        return self.numbers[self.firsts[index] : self.firsts[index + 1]]


def write_capture(capture: Capture, folder: Path) -> None:
    """Write a capture; its pictures are there already. capture.json appears last.

    Raises:
        StoreError: it cannot be written.
    """
    seen = _Lists.of([shot.seen for shot in capture.shots])
    with atomic_path(folder / _POINTS) as temporary:
        np.savez_compressed(
            temporary,
            allow_pickle=False,
            points=capture.points.astype(np.float64),
            colours=capture.colours.astype(np.uint8),
            errors=capture.errors.astype(np.float32),
            seen=seen.numbers,
            firsts=seen.firsts,
        )
    shots = [
        {
            "name": shot.name,
            "file": shot.file,
            "mask": shot.mask,
            "lens": None if shot.lens is None else vars(shot.lens),
            "T_world_camera": shot.camera.T_world_camera.tolist(),
            **{k: getattr(shot.camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")},
        }
        for shot in capture.shots
    ]
    with atomic_path(folder / _JSON) as temporary:
        frame = {"metric": capture.metric, "up": capture.up}
        text = json.dumps({"nw-capture": 1, **frame, "shots": shots}, indent=1)
        temporary.write_text(text, encoding="utf-8")


def read_capture(folder: Path) -> Capture:
    """Read a capture, not its pictures.

    Raises:
        SceneError: the capture is missing or damaged, or names a file outside its folder.
    """
    path = folder / _JSON
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise ValueError(f"it is larger than {_MOST_BYTES} bytes")
        file = _File.model_validate_json(path.read_bytes())
        with np.load(regular(folder / _POINTS), allow_pickle=False) as arrays:
            points, colours, errors, numbers, firsts = (
                arrays[key].astype(kind, casting="same_kind") for key, kind in _KINDS.items()
            )
        seen = _Lists(numbers, firsts)
        if len(seen.firsts) != len(file.shots) + 1:
            raise ValueError(f"{len(file.shots)} shots, {len(seen.firsts) - 1} lists of points")
        shots = [_shot(one, seen[index], folder) for index, one in enumerate(file.shots)]
        return Capture(
            shots=tuple(shots),
            points=points,
            colours=colours,
            errors=errors,
            metric=file.metric,
            up=file.up,
        )
    except FileNotFoundError as error:
        raise SceneError(
            f"no capture in {folder}: {error.filename} is not there", fix=_FIX
        ) from None
    except SceneError as error:
        raise SceneError(f"{path}: {error.message}", fix=error.fix) from None
    except (*_DAMAGE, OutsideError, UsageError) as error:
        raise SceneError(f"{path} is not a capture: {first_problem(error)}", fix=_FIX) from None


def _shot(one: _Shot, seen: NDArray[np.int32], folder: Path) -> PlacedShot:
    for name in (one.file, one.mask):
        if name is not None:
            inside(folder, name)
    pose = np.array(one.T_world_camera)
    if np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() > _TURN:
        raise ValueError(f"the pose of {one.name} has no rotation: {pose[:3, :3].tolist()}")
    lens = None if one.lens is None else Lens(**one.lens.model_dump())
    if lens is not None:
        lens.check()
    return PlacedShot(
        name=one.name,
        file=one.file,
        mask=one.mask,
        seen=seen,
        lens=lens,
        camera=Camera(
            width=one.width,
            height=one.height,
            fx=one.fx,
            fy=one.fy,
            cx=one.cx,
            cy=one.cy,
            T_world_camera=pose,
        ),
    )


def read_picture(shot: PlacedShot, folder: Path) -> NDArray[np.uint8]:
    """Return a shot's picture, (H, W, 3) uint8.

    Raises:
        SceneError: it is not there, is not a picture, or has another size than its camera.
    """
    path = folder / shot.file
    try:
        path = inside(folder, shot.file)
        with open_picture(path) as image:
            if image.size != (shot.camera.width, shot.camera.height):
                raise SceneError(
                    f"{path} has {image.size} pixels, its camera "
                    f"{(shot.camera.width, shot.camera.height)}",
                    fix=_FIX,
                )
            if image.width * image.height > _MOST_PIXELS:
                raise SceneError(f"{path} has more than {_MOST_PIXELS} pixels", fix=_FIX)
            return np.asarray(image.convert("RGB"))
    except _DAMAGE as error:
        raise SceneError(f"{path} cannot be read: {error}", fix=_FIX) from None
