"""One recording of Rerun: entities with what stays, what changes, and numbers over time.

Layouts, which Rerun calls blueprints, show the scene, pictures, plots and events. Numbers of a log
that Rerun reads itself are fields of messages, which a plot finds by selectors
(https://rerun.io/docs/howto/visualization/plot-any-scalar); those of our recordings are scalars.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from nw_eval.viewing.shown import Line, Plot, Shown

TIME = "sim_time"
"""The timeline: simulated seconds since the trial's start."""

Times = Sequence[int]
"""Nanoseconds of simulated time."""

APPLICATION = "nw-eval"
"""The application of recordings and layouts; Rerun keeps one layout for each."""

_FIX = "pip install 'nw-eval[rerun]'"


class Track:
    """Writes to Rerun's file of one recording. No viewer is started, nothing goes over a network.

    Args:
        recording_id: of the recording; the same trial has the same one.
        path: of the file.
        name: of the recording, for people.
    """

    def __init__(self, recording_id: str, path: Path, *, name: str) -> None:
        self.rr = rerun_sdk()
        # Its own properties are the time of day.
        self._stream = self.rr.RecordingStream(
            APPLICATION, recording_id=recording_id, send_properties=False
        )
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.save(str(path))
        self._stream.send_recording_name(name)

    def lay_out(self, layout: Any) -> None:
        """Say what a viewer shows when it opens the file."""
        self._stream.send_blueprint(layout, make_active=True, make_default=True)

    def entity(self, *parts: str) -> str:
        """Return an entity's path; the parts may be untrusted words."""
        return str(self.rr.new_entity_path(list(parts)))

    def stays(self, entity: str, what: Any) -> None:
        """Write what does not change."""
        self._stream.log(entity, what, static=True, strict=True)

    def at(self, time_ns: int, entity: str, what: Any) -> None:
        """Write what is so from a time on."""
        self._stream.set_time(TIME, duration=np.timedelta64(time_ns, "ns"))
        self._stream.log(entity, what, strict=True)

    def moves(self, entity: str, times: Times, columns: Any) -> None:
        """Write what is another at each of some times."""
        since = np.asarray(times, np.int64).astype("timedelta64[ns]")
        self._stream.send_columns(
            entity, [self.rr.TimeColumn(TIME, duration=since)], columns, strict=True
        )

    def numbers(self, entity: str, times: Times, rows: NDArray[Any], names: Sequence[str]) -> None:
        """Write (T, N) numbers at T times, each with a name of its own."""
        self.stays(entity, self.rr.SeriesLines(names=list(names)))
        scalars = self.rr.Scalars.columns(scalars=rows.astype(np.float64).ravel())
        self.moves(entity, times, scalars.partition([rows.shape[1]] * len(rows)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        """Finish the file.

        Raises:
            OSError: the disk did not take it.
        """
        try:
            if error is None:
                self._stream.flush()
        except RuntimeError as lost:  # Rerun writes in a thread, which has told stderr why it died.
            raise OSError("Rerun could not write all of it") from lost
        finally:
            self._stream.disconnect()


def rerun_sdk() -> Any:
    """Return the package `rerun`, with its blueprints.

    Raises:
        PrerequisiteError: it is missing, too old, or another package of that name.
    """
    try:
        sdk: Any = import_module("rerun")
        import_module("rerun.blueprint")
    except ImportError as error:
        raise PrerequisiteError(f"Rerun's files need the package {error.name}", fix=_FIX) from error
    if not hasattr(sdk, "GaussianSplats3D"):
        version = getattr(sdk, "__version__", "another package")
        raise PrerequisiteError(f"Rerun's files need rerun-sdk 0.41, not {version}", fix=_FIX)
    return sdk


@dataclass(frozen=True, kw_only=True)
class WrittenRecording:
    """A recording of Rerun that was written."""

    file: Path
    bytes: int
    gaussians: int
    """Of the scene's splat; 0 = it is not in the recording."""
    no_splat: str
    """Why it is not; empty if it is."""


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
