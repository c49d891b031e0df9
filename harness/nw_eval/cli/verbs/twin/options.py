"""Options that the verbs of a twin share: each stage's own, and those of a whole build."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from nw_eval.words import Robot

if TYPE_CHECKING:
    from nw_eval.twin.building.build import BuildSettings


@dataclass(frozen=True, kw_only=True)
class CalibrateFlags:
    """Of the cameras."""

    matching: Literal["auto", "sequential", "exhaustive"] = "auto"
    """Which photographs are compared: neighbours in the order of their names (sequential), all
    (exhaustive), or neighbours where names are numbers or a video's frames."""
    frames: int = 150
    """Frames that are taken of a video, at most: sharp ones, some way apart."""


@dataclass(frozen=True, kw_only=True)
class ReconstructFlags:
    """Of the mesh."""

    mesher: Literal["sweep", "openmvs"] = "sweep"
    """Our own plane sweep, or the programs of OpenMVS, which must be on PATH."""
    faces: int = 200_000
    """Faces of the mesh, at most."""


@dataclass(frozen=True, kw_only=True)
class AlignFlags:
    """Of gravity and scale. With a printed tag in view nothing else is wanted."""

    tag_edge: float | None = None
    """Outer edge of the black border of the AprilTags (36h11) that lie about, m."""
    camera_height: float | None = None
    """Height at which the camera was held above the floor, the median, m."""
    metric: bool = False
    """The cameras that were taken as they are (ARKit, Polycam) are in metres already."""


@dataclass(frozen=True, kw_only=True)
class SplatFlags:
    """Of the Gaussians."""

    iterations: int = 6000
    """Steps of training."""
    gaussians: int = 200_000
    """Gaussians, at most."""
    longest: int = 480
    """Longest side of the pictures that are learnt from, pixels."""
    held_out: str = ""
    """Photographs that are kept from training to compare with, such as 'low_*'; every eighth when
    absent."""


@dataclass(frozen=True, kw_only=True)
class PlaceFlags:
    """Of the scene."""

    name: str | None = None
    """The scene's name; that of its folder when absent."""
    licence: str = "unknown"
    """Of the photographs: an SPDX identifier, or words."""
    robot: Robot = "go1"
    """The robot of the scene's suite: whose feet, camera and length the check goes by."""


@dataclass(frozen=True, kw_only=True)
class AllFlags(CalibrateFlags, ReconstructFlags, AlignFlags, SplatFlags, PlaceFlags):
    """Of a whole build."""


def settings_of(flags: object, threads: int | None) -> BuildSettings:
    """Return what a build is asked to do; what a verb has no flag for is as it is by default.

    Raises:
        UsageError: a number makes no sense.
    """
    from nw_eval.results.machine import usable_cores
    from nw_eval.twin.align.alignment import AlignOptions
    from nw_eval.twin.building.appearance import AppearanceOptions
    from nw_eval.twin.building.build import BuildSettings
    from nw_eval.twin.calibrate.options import CalibrateOptions
    from nw_eval.twin.reconstruct.options import ReconstructOptions

    has = vars(AllFlags()) | {k: v for k, v in vars(flags).items() if k in vars(AllFlags())}
    cores = threads or usable_cores()
    return BuildSettings(
        calibrate=CalibrateOptions(matching=has["matching"], frames=has["frames"], threads=cores),
        reconstruct=ReconstructOptions(engine=has["mesher"], faces=has["faces"]),
        align=AlignOptions(
            tag_edge=has["tag_edge"], camera_height=has["camera_height"], metric=has["metric"]
        ),
        splat=AppearanceOptions(
            iterations=has["iterations"],
            most=has["gaussians"],
            longest=has["longest"],
            held_out=has["held_out"],
        ),
        name=has["name"],
        licence=has["licence"],
        robot=has["robot"],
        threads=cores,
    )
