"""Layouts of Rerun, which it calls blueprints: the scene, pictures, plots and events.

Numbers of a log that Rerun reads itself are fields of messages, which a plot finds by selectors
(https://rerun.io/docs/howto/visualization/plot-any-scalar); those of our recordings are scalars.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from nw_eval.viewing.recording.track import APPLICATION, rerun_sdk

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from nw_eval.viewing.shown import Line, Plot, Shown

LOG_TIME = "message_log_time"
"""The timeline that Rerun makes of a log's time."""

_SCHEMAS = {
    "/nw/policy": "nw.PolicyStep",
    "/robot/command": "nw.Command",
    "/robot/twist": "nw.Twist",
}
_PLOT_SHARE, _PLACE_SHARE = 2.0, 3.0
_EYE = (-2.0, -2.0, 1.4)  # m from the robot
PLANE = 0.3
"""Metres before a camera at which a view of the scene shows its picture."""


@dataclass(frozen=True, kw_only=True)
class SceneScreen:
    """Where everything stands, and what of it a view follows."""

    root: str
    """The entity under which all lies that has a pose."""
    follows: str
    """The robot's."""
    start: tuple[float, float, float] | None
    """Where it stands first, m."""
    hides: tuple[str, ...] = ()
    """Entities that one has to ask for."""
    cameras: tuple[str, ...] = ()
    """Entities of cameras whose pictures are to stand close before them."""


def save_layout(shown: Shown, path: Path) -> None:
    """Write the layout of a log that Rerun itself has converted.

    Raises:
        PrerequisiteError: Rerun is not installed.
    """
    rerun_sdk()
    plots = [_plot_of_messages(plot) for plot in shown.plots]
    whole = blueprint(
        place=SceneScreen(
            root="/",
            follows=f"/points/robot/{shown.trunk}",
            start=shown.start,
            cameras=tuple(f"{topic}/calib" for topic in shown.pictures),
        ),
        pictures={topic: topic for topic in shown.pictures},
        plots=plots,
        timeline=LOG_TIME,
    )
    whole.save(APPLICATION, str(path))


def blueprint(
    *, place: SceneScreen, pictures: Mapping[str, str], plots: Sequence[Any], timeline: str
) -> Any:
    """Return a layout.

    Args:
        place: where everything stands.
        pictures: entities of images, and what their views are called.
        plots: views of numbers.
        timeline: by which it is played.
    """
    rrb = rerun_sdk().blueprint
    images = [rrb.Spatial2DView(origin=entity, name=name) for entity, name in pictures.items()]
    right = [rrb.Horizontal(*images)] if images else []
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin=place.root,
                    name="Place",
                    eye_controls=_eye(place),
                    overrides=_overrides(place),
                ),
                rrb.TextLogView(origin="/log", name="Events"),
                row_shares=[5.0, 1.0],
            ),
            rrb.Vertical(*right, *plots),
            column_shares=[_PLACE_SHARE, _PLOT_SHARE],
        ),
        rrb.TimePanel(timeline=timeline, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _overrides(place: SceneScreen) -> dict[str, Any]:
    rr = rerun_sdk()
    hidden = rr.blueprint.EntityBehavior(visible=False)
    close = rr.Pinhole.from_fields(image_plane_distance=PLANE)
    return {**dict.fromkeys(place.hides, hidden), **dict.fromkeys(place.cameras, close)}


def _eye(place: SceneScreen) -> Any:
    """Return an eye that looks at the robot from behind and follows it."""
    x, y, z = place.start or (0.0, 0.0, 0.0)
    dx, dy, dz = _EYE
    return rerun_sdk().blueprint.EyeControls3D(
        position=(x + dx, y + dy, z + dz), look_target=(x, y, z), tracking_entity=place.follows
    )


def plot_of_entities(title: str, entities: Sequence[str]) -> Any:
    """Return a plot of entities that are scalars."""
    return rerun_sdk().blueprint.TimeSeriesView(origin="/", contents=entities, name=title)


def _plot_of_messages(plot: Plot) -> Any:
    rrb = rerun_sdk().blueprint
    lines: defaultdict[str, list[Any]] = defaultdict(list)
    for line in plot.lines:
        lines[line.topic].append(_line_of_messages(line))
    return rrb.TimeSeriesView(
        origin="/", contents=list(lines), name=plot.title, overrides=dict(lines)
    )


def _line_of_messages(line: Line) -> Any:
    rr = rerun_sdk()
    encodings = rr.blueprint.encodings
    mapping = encodings.VisualizerComponentMapping(
        "Scalars:scalars",
        encodings.ComponentSourceKind.SourceComponent,
        source_component=f"{_SCHEMAS.get(line.topic, 'nw.Observation')}:message",
        selector=f".{line.field}",
    )
    name = line.label or f"{line.topic}.{line.field}"
    return rr.SeriesLines(names=name).visualizer(mappings=[mapping])
