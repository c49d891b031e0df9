"""All that a build is asked to do."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from nw_eval.twin.align import AlignOptions
from nw_eval.twin.appearance import AppearanceOptions
from nw_eval.twin.calibrate import CalibrateOptions
from nw_eval.twin.reconstruct import ReconstructOptions
from nw_eval.words import Robot


@dataclass(frozen=True, kw_only=True)
class BuildSettings:
    """Options of each stage, and what the place is called.

    Attributes:
        calibrate: of calibration.
        reconstruct: of the mesh.
        align: gravity and scale.
        splat: of the Gaussians.
        name: of the scene; the folder's name if None.
        licence: of the photographs, which the place shows.
        robot: of the scene's suite, by which the place is checked.
        threads: that share the work; no result depends on them.
    """

    calibrate: CalibrateOptions = field(default_factory=CalibrateOptions)
    reconstruct: ReconstructOptions = field(default_factory=ReconstructOptions)
    align: AlignOptions = field(default_factory=AlignOptions)
    splat: AppearanceOptions = field(default_factory=AppearanceOptions)
    name: str | None = None
    licence: str = "unknown"
    robot: Robot = "go1"
    threads: int = 2


def facts_of(options: Any) -> str:
    """Return options as text that is the same whenever they ask for the same."""
    return repr(sorted((k, v) for k, v in asdict(options).items() if k != "threads"))
