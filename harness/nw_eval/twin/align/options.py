"""What a person may say about a capture, so that it can be aligned."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from nw_eval.errors import UsageError
from nw_eval.scenes.scene import Vector
from nw_eval.words import UpAxis

Pixel = tuple[float, float]
"""x and y in pixels; the centre of the first one is at (0.5, 0.5)."""

TagFamily = Literal["tag36h11", "tag25h9", "tag16h5", "aruco_4x4_50", "aruco_5x5_100"]
"""Printed marks that are found in pictures: AprilTags, or ArUco markers."""


@dataclass(frozen=True, kw_only=True)
class KnownLength:
    """Two points of a place whose distance somebody measured.

    Attributes:
        first, second: (x, y, z) in the capture's frame; or pixels by the name of the shot in which
            the point was picked, two shots at least.
        metres: between them.
        vertical: whether `metres` is a height, so that only the way up between them counts.
    """

    first: Vector | Mapping[str, Pixel]
    second: Vector | Mapping[str, Pixel]
    metres: float
    vertical: bool = False

    def __post_init__(self) -> None:
        """Check the length.

        Raises:
            UsageError: it is no positive number.
        """
        _positive("a known length", self.metres)


@dataclass(frozen=True, kw_only=True)
class AlignOptions:
    """Facts that no photograph tells; a tag of known edge is enough.

    Attributes:
        tag_edge: outer edge of the black border of every tag, metres; None where there are none.
        tag_edges: edges of single tags that differ, metres, by the number of the tag.
        tag_family: which tags there are.
        camera_height: median height of the cameras above the floor, metres.
        lengths: measured by somebody.
        metric: whether the poses come in metres already, as those of ARKit and Polycam.
        positions: where shots were taken, (x, y, z) in metres of any frame, by their names: ARKit,
            or GPS by `gps_positions`. Three at least.
        positions_up: which way is up in the frame of `positions`; None where nobody knows.
        up: which way is up in the capture's own frame, where its poses' source says so.
        seed: of the draws.
    """

    tag_edge: float | None = None
    tag_edges: Mapping[int, float] = field(default_factory=dict[int, float])
    tag_family: TagFamily = "tag36h11"
    camera_height: float | None = None
    lengths: tuple[KnownLength, ...] = ()
    metric: bool = False
    positions: Mapping[str, Vector] = field(default_factory=dict[str, Vector])
    positions_up: UpAxis | None = None
    up: UpAxis | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the lengths.

        Raises:
            UsageError: naming the one that is no positive number.
        """
        if self.tag_edge is not None:
            _positive("tag_edge", self.tag_edge)
        for number, edge in self.tag_edges.items():
            _positive(f"the edge of tag {number}", edge)
        if self.camera_height is not None:
            _positive("camera_height", self.camera_height)


def _positive(what: str, metres: float) -> None:
    if not (math.isfinite(metres) and metres > 0):
        raise UsageError(f"{what} is {metres}", fix="give metres, more than 0")
