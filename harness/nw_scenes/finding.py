"""One thing that somebody should know about a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from nw_base.clean import clean
from nw_base.errors import SceneError

Code = Literal[
    "beyond_legs",
    "far_from_captures",
    "feet_sink",
    "floor_offset",
    "ground_missing",
    "ground_rough",
    "ground_unseen",
    "ground_untouched",
    "hole",
    "inconsistent_meshes",
    "inside_out",
    "layered_sheet",
    "mesh_partly_read",
    "mesh_turned",
    "mesh_wide",
    "not_to_scale",
    "no_floor_under_spawn",
    "no_splat",
    "open_view",
    "overhang",
    "spawn_blocked",
    "splat_elsewhere",
    "splat_empty",
    "splat_invalid",
    "splat_off_mesh",
    "splat_partly_read",
    "splat_shifted",
    "splat_thin",
    "task_guessed",
    "terrain_error",
    "thin_wall",
    "trail_short",
    "two_splats",
    "under_floor",
    "unlike_photographs",
    "unreadable",
    "upside_down",
    "waypoint_above_surface",
    "waypoint_at_end",
    "waypoint_at_start",
    "waypoint_below_surface",
    "waypoint_off_mesh",
    "waypoints_together",
    "xml_disagree",
]
Severity = Literal["error", "warning", "note"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SceneFinding:
    """A fault or a peculiarity of a scene.

    Attributes:
        code: which kind; stable, for machines.
        severity: an `error` makes results meaningless, a `warning` may change them, a `note` is
            how the scene was understood.
        message: what was found, with its value and place.
        fix: what to do about it.
        value: the number in question, in SI units.
        place: where, metres, world.
    """

    code: Code
    severity: Severity
    message: str
    fix: str | None = None
    value: float | None = None
    place: Vector | None = None

    def __str__(self) -> str:
        text = f"{self.severity} {self.code}: {clean(self.message, at_most=2000)}"
        return text if self.fix is None else f"{text}; {clean(self.fix)}"


def has_errors(findings: Iterable[SceneFinding]) -> bool:
    """Return whether any finding is an error: then `nw-eval scenes check` exits with 2."""
    return any(finding.severity == "error" for finding in findings)


def unreadable(error: SceneError) -> tuple[SceneFinding, ...]:
    """Return what kept a scene from being read, a finding for each line of the error."""
    lines = str(error).splitlines()
    return tuple(SceneFinding(code="unreadable", severity="error", message=line) for line in lines)
