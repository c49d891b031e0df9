"""What aligning a capture is asked and comes to: options, each cue's answer, and align.json."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from nw_base.errors import NwEvalError, SceneError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import regular
from nw_base.words import UpAxis
from nw_scenes.capture_file import first_problem
from nw_scenes.limits import check_similarity
from nw_scenes.scene import Vector

Pixel = tuple[float, float]
"""x and y in pixels; the centre of the first one is at (0.5, 0.5)."""

MOST_DEGREES = 2.0
"""A cue for gravity that is further off, and by more than twice what it is unsure, is warned of."""

MOST_DIFFERENCE = 0.03
"""Tags, or lengths, that differ among themselves by more are warned of, or refused."""

_POINT = re.compile(r"(.+?):([0-9]+(?:\.[0-9]+)?),([0-9]+(?:\.[0-9]+)?)(?:\+|$)")
"""A photograph's name and a pixel of it; `+` before the next."""
_MOST_BYTES = 2**20
_FIX = "align again: `nw-eval twin align`"

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


CARRIED = 1.5
"""Metres above the floor at which people carry a camera: the unit where nothing gives a scale."""


@dataclass(frozen=True, kw_only=True)
class KnownLength:
    """Two points of a scene whose distance was measured.

    Attributes:
        first, second: (x, y, z) in the capture's frame; or pixels by the name of the shot in which
            the point was picked. In one shot it is where the pixel's ray meets the mesh, in two or
            more where the rays meet. Pixels are of the photograph as it was taken, or of the
            capture's picture where the capture does not know the lens.
        metres: between them.
    """

    first: Vector | Mapping[str, Pixel]
    second: Vector | Mapping[str, Pixel]
    metres: float

    def __post_init__(self) -> None:
        """Check the length; UsageError says what cannot be."""
        _positive("a known length", self.metres)
        first, second = self.first, self.second
        if not (isinstance(first, Mapping) and isinstance(second, Mapping)):
            return
        if first.items() & second.items():
            raise UsageError(
                f"the two points of a length of {self.metres:g} m are one: {words_of(first)} "
                f"and {words_of(second)}",
                fix="pick two points apart",
            )

    @classmethod
    def of_words(cls, first: str, second: str, metres: float) -> KnownLength:
        """Return the length between two points that are written as `IMG_1.jpg:412,310`.

        A point that two photographs show is written as `IMG_1.jpg:412,310+IMG_2.jpg:97,305`. The
        first pixel of a photograph is 0,0, as in image viewers.

        Raises:
            UsageError: a point is written otherwise, or the length is no positive number.
        """
        return cls(first=_picked(first), second=_picked(second), metres=metres)


def _picked(text: str) -> dict[str, Pixel]:
    picked: dict[str, Pixel] = {}
    end = 0
    for match in _POINT.finditer(text):
        name, x, y = match.groups()
        if match.start() != end or name in picked:
            break
        picked[name], end = (float(x) + 0.5, float(y) + 0.5), match.end()
    if not picked or end != len(text) or text.endswith("+"):
        raise UsageError(
            f"{text!r} is not a point of a photograph",
            fix="write the photograph's name and the pixel, IMG_1.jpg:412,310; or two photographs "
            "that show the point, IMG_1.jpg:412,310+IMG_2.jpg:97,305",
        )
    return picked


def words_of(point: Vector | Mapping[str, Pixel]) -> str:
    """Return a point of a known length as `KnownLength.of_words` reads it."""
    if not isinstance(point, Mapping):
        return str(tuple(point))
    return "+".join(f"{name}:{x - 0.5:g},{y - 0.5:g}" for name, (x, y) in point.items())


def check_inside(name: str, pixel: Pixel, size: tuple[int, int]) -> None:
    """Check that a pixel is one of a photograph.

    Args:
        name: of the photograph.
        pixel: of it.
        size: its width and height, upright.

    Raises:
        UsageError: it is not.
    """
    if not (0 <= pixel[0] <= size[0] and 0 <= pixel[1] <= size[1]):
        raise UsageError(
            f"{words_of({name: pixel})} is outside the photograph, which has {size[0]} x "
            f"{size[1]} pixels",
            fix="count pixels from its top left corner, in the photograph as it was taken",
        )


@dataclass(frozen=True, kw_only=True)
class AlignOptions:
    """Facts that no photograph tells; a tag of known edge is enough.

    Attributes:
        tag_edge: outer edge of the black border of every AprilTag (36h11), metres; None where there
            are none.
        camera_height: median height of the cameras above the floor, metres.
        lengths: measured by somebody.
        metric: whether the poses come in metres already, as those of ARKit and Polycam.
        positions: where shots were taken, (x, y, z) in metres of any frame, by their names: ARKit,
            or GPS by `gps_positions`. Three at least.
        positions_up: which way is up in the frame of `positions`; None if unknown.
        positions_error: metres by which all positions may be off as GPS is, besides their scatter.
        up: which way is up in the capture's own frame, where its poses' source says so.
        seed: of the draws.
    """

    tag_edge: float | None = None
    camera_height: float | None = None
    lengths: tuple[KnownLength, ...] = ()
    metric: bool = False
    positions: Mapping[str, Vector] = field(default_factory=dict[str, Vector])
    positions_up: UpAxis | None = None
    positions_error: float = 0.0
    up: UpAxis | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the lengths; UsageError says what cannot be."""
        if self.tag_edge is not None:
            _positive("tag_edge", self.tag_edge)
        if self.camera_height is not None:
            _positive("camera_height", self.camera_height)
        _check_ways(self.lengths)


def _check_ways(lengths: Sequence[KnownLength]) -> None:
    """Refuse a length longer by `MOST_DIFFERENCE` than a way between its points over others."""
    numbers: dict[str, int] = {}
    ends = [
        tuple(numbers.setdefault(words_of(end), len(numbers)) for end in (one.first, one.second))
        for one in lengths
    ]
    ways = np.full((len(numbers), len(numbers)), np.inf)
    for one, (a, b) in zip(lengths, ends, strict=True):
        ways[a, b] = ways[b, a] = min(ways[a, b], one.metres)
    for middle in range(len(numbers)):  # Floyd and Warshall.
        ways = np.minimum(ways, ways[:, middle, None] + ways[middle])
    for one, (a, b) in zip(lengths, ends, strict=True):
        if one.metres > (1.0 + MOST_DIFFERENCE) * ways[a, b]:
            raise UsageError(
                f"the lengths contradict each other: {one.metres:g} m between "
                f"{words_of(one.first)} and {words_of(one.second)}, and {ways[a, b]:g} m by others",
                fix="measure again, or drop one",
            )


def _positive(what: str, metres: float) -> None:
    if not (math.isfinite(metres) and metres > 0):
        raise UsageError(f"{what} is {metres}", fix="give metres, more than 0")


@dataclass(frozen=True, kw_only=True)
class GravityCue:
    """One answer to which way is up.

    Attributes:
        name: `horizon`, `floor`, `walls`, `mesh`, `edges`, `poses` or `positions`.
        up: unit vector in the capture's frame.
        degrees: between it and the chosen direction.
        uncertain: standard deviation of its direction, degrees.
        reason: what it is and how sure, for people.
    """

    name: str
    up: Vector
    degrees: float
    uncertain: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class ScaleCue:
    """One answer to how long a unit of the capture is.

    Attributes:
        name: `tag`, `camera height`, `poses`, `positions` or `length`.
        scale: metres in a unit.
        difference: relative to the chosen scale; 0.01 is one percent more.
        used: whether it counts: nothing else refutes it.
        reason: what it is and how sure, for people.
        uncertain: relative error that it claims to have with 95 % at most; None in a file that
            does not say.
    """

    name: str
    scale: float
    difference: float
    used: bool
    reason: str
    uncertain: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """The similarity from a capture's frame to metres: z up, the floor at z = 0.

    The origin lies on the floor below the first shot; x leads to the shot farthest from it.

    Attributes:
        T_metric_capture: (4, 4) float64, a scale times a rotation, and a translation.
        scale: metres in a unit of the capture; where nothing gives a scale, such that the cameras
            are as high above the floor as people hold them.
        gravity: each cue's answer.
        scales: each cue's answer, the best known first; none is used where nothing gives a scale.
        floor_share: of the points, those on the mesh with them, which lies on the floor.
        warnings: what somebody should look at.
        up_uncertain: angle within which up lies with 95 %, degrees; None in a file that
            does not say.
        scale_uncertain: relative error that the scale has with 95 % at most; None where nothing
            gives one.
    """

    T_metric_capture: NDArray[np.float64]
    scale: float
    gravity: tuple[GravityCue, ...]
    scales: tuple[ScaleCue, ...]
    floor_share: float
    warnings: tuple[str, ...]
    up_uncertain: float | None = None
    scale_uncertain: float | None = None

    @property
    def is_to_scale(self) -> bool:
        """Whether the metric frame is in metres, not in an unknown unit."""
        return any(cue.used for cue in self.scales)


def placed(
    *,
    up: NDArray[np.float64],
    scale: float,
    floor: float,
    centres: NDArray[np.float64],
    forward: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return T_metric_capture (4, 4).

    The origin lies on the floor below the first camera, x leads to the camera that is farthest from
    it in the plane. Where no camera moved, x is the way that the first one looks.

    Args:
        up: (3,) unit vector in the capture's frame.
        scale: metres in a unit of the capture.
        floor: its height along `up`, in the capture's unit.
        centres: (V, 3) of the cameras, one at least.
        forward: (3,) where the first camera looks.
    """
    ways = centres - centres[0]
    ways = ways - np.einsum("ni,i->n", ways, up)[:, None] * up
    lengths = np.linalg.norm(ways, axis=1)
    heights = np.einsum("ni,i->n", centres, up) - floor
    x = ways[int(np.argmax(lengths))]
    if lengths.max() < 0.05 * float(np.abs(heights).max()):
        x = forward - (forward @ up) * up
    if np.linalg.norm(x) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        x = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])  # It looks straight down.
    x = x - (x @ up) * up
    x = x / np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = centres[0] - float(heights[0]) * up
    T = np.eye(4)
    T[:3, :3] = scale * rotation
    T[:3, 3] = -scale * rotation @ origin
    return T


class _AlignModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _GravityEntry(_AlignModel):
    name: str
    up: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    degrees: Annotated[float, Field(ge=0, le=180)]
    uncertain: Annotated[FiniteFloat, Field(ge=0)]
    reason: str


class _ScaleEntry(_AlignModel):
    name: str
    scale: Annotated[FiniteFloat, Field(gt=0)]
    difference: FiniteFloat
    used: bool
    reason: str
    uncertain: Annotated[FiniteFloat, Field(ge=0)] | None = None


class _AlignFile(_AlignModel):
    version: int = Field(alias="nw-align", default=1, ge=1, le=1)
    T_metric_capture: Annotated[tuple[_Row, ...], Field(min_length=4, max_length=4)]
    scale: Annotated[FiniteFloat, Field(gt=0)]
    floor_share: Annotated[float, Field(ge=0, le=1)]
    gravity: tuple[_GravityEntry, ...]
    scales: tuple[_ScaleEntry, ...]
    warnings: tuple[str, ...]
    up_uncertain: Annotated[float, Field(ge=0, le=180)] | None = None
    scale_uncertain: Annotated[FiniteFloat, Field(ge=0)] | None = None


def write_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment; the file appears whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    content = {
        "nw-align": 1,
        "T_metric_capture": alignment.T_metric_capture.tolist(),
        "scale": alignment.scale,
        "floor_share": alignment.floor_share,
        "gravity": [vars(cue) for cue in alignment.gravity],
        "scales": [vars(cue) for cue in alignment.scales],
        "warnings": alignment.warnings,
        "up_uncertain": alignment.up_uncertain,
        "scale_uncertain": alignment.scale_uncertain,
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_alignment(path: Path) -> Alignment:
    """Read an alignment.

    Raises:
        SceneError: the file is missing or damaged, or its matrix is no similarity of its scale.
    """
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise SceneError(f"{path} is larger than {_MOST_BYTES} bytes", fix=_FIX)
        file = _AlignFile.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        raise SceneError(f"there is no {path}", fix=_FIX) from None
    except NwEvalError:
        raise
    except (OSError, ValueError) as error:
        raise SceneError(f"{path} is not an alignment: {first_problem(error)}", fix=_FIX) from None
    T = np.array(file.T_metric_capture)
    scale = check_similarity(T, str(path))
    if abs(scale / file.scale - 1.0) > 1e-6 or (T[3] != [0, 0, 0, 1]).any():
        raise SceneError(
            f"{path}: its matrix has the scale {scale:g} and the last row {T[3].tolist()}, "
            f"the file says {file.scale:g}",
            fix=_FIX,
        )
    return Alignment(
        T_metric_capture=T,
        scale=file.scale,
        gravity=tuple(GravityCue(**cue.model_dump()) for cue in file.gravity),
        scales=tuple(ScaleCue(**cue.model_dump()) for cue in file.scales),
        floor_share=file.floor_share,
        warnings=file.warnings,
        up_uncertain=file.up_uncertain,
        scale_uncertain=file.scale_uncertain,
    )
