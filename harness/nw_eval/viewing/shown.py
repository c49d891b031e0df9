"""What a viewer shows of a log when it is opened, whichever viewer it is.

A layout of Foxglove and Lichtblick has the format that both programs export and import
(`configById`, and `layout`, a tree of panels). Paths of plots are message paths:
https://docs.foxglove.dev/docs/visualization.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

from nw_base.errors import StoreError
from nw_policies.cards.wrappers import Flatten, PluginWrap
from nw_sim.rollout.observed import (
    LOG_TOPIC,
    action_names,
    element_names,
    term_sizes,
    topic_names,
    value_paths,
    views_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_policies.cards import Card
    from nw_scenes.robots import RobotSpec
    from nw_sim.rollout.mcap.reader import LogReader

_MOST_PICTURES = 3
_LEG, _MOST_LINES = 3, 6


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a plot."""

    topic: str
    field: str
    """Where the number lies in the topic's messages, such as `terms[0].values[2]`."""
    label: str = ""
    """Its name in the legend; empty = topic and field."""


@dataclass(frozen=True, kw_only=True)
class Plot:
    """Some lines over time."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What is shown of a log."""

    trunk: str
    """The frame that a view of the scene follows."""
    start: tuple[float, float, float] | None
    """Where it is first, m; None if it is not known yet."""
    pictures: tuple[str, ...]
    """Topics of images, a few."""
    plots: tuple[Plot, ...]
    observation: str | None
    """A topic of numbers that the policy was given, to be shown in full."""


_VELOCITY = Plot(
    title="Velocity, commanded and measured",
    lines=(
        Line(topic="/robot/command", field="forward"),
        Line(topic="/robot/twist", field="linear.x"),
        Line(topic="/robot/command", field="yaw_rate"),
        Line(topic="/robot/twist", field="angular.z"),
        Line(topic="/robot/command", field="heading_error"),
    ),
)


def shown_by_card(card: Card, robot: RobotSpec) -> Shown:
    """Return what logs of a policy will have to show, before there is one."""
    views = views_of(card)
    # What somebody else's wrapper leaves of an image is known in a trial only.
    sure = [v for v in views if not any(isinstance(w, Flatten | PluginWrap) for w in v.spec.wrap)]
    cameras = {view.observation for view in views}
    topics = {
        name: f"/observation/{topic}"
        for name, topic in topic_names(card).items()
        if name not in cameras
    }
    names = action_names(card, robot)
    seen: tuple[Line, ...] = ()
    for name, topic in topics.items():
        spec = card.observations[name]
        if elements := element_names(spec, names["/nw/policy.action"]):
            sizes = term_sizes(name, spec, len(elements), names["/nw/policy.action"])
            seen = _lines(topic, sizes, elements)
            break
    return _shown(
        trunk=robot.bodies[0],
        start=None,
        pictures=[view.topic for view in sure] if views else [LOG_TOPIC],
        targets=names["/nw/policy.targets"],
        seen=seen,
        observation=next(iter(topics.values()), None),
    )


def shown_in_log(log: LogReader) -> Shown:
    """Return what a log has to show.

    Raises:
        StoreError: it cannot be read, or is damaged.
    """
    elements = log.elements()
    first: dict[str, Any] = {}
    for topic, _, message in log.messages():
        first.setdefault(topic, message)
    observations = [topic for topic in first if topic.startswith("/observation/")]
    named = next((topic for topic in observations if topic in elements), None)
    if not {"/robot/twist", "/robot/odom"} <= set(first):
        raise StoreError(f"{log.path} does not say where its robot was", fix="run the trial again")
    position = first["/robot/odom"].pose.position
    return _shown(
        trunk=first["/robot/twist"].frame_id,
        start=(position.x, position.y, position.z),
        pictures=[t for t in first if t.startswith("/camera/") and not t.endswith("/calib")],
        targets=elements.get("/nw/policy.targets", ("",) * _LEG),
        seen=() if named is None else _lines(named, _sizes(first[named]), elements[named]),
        observation=next(iter(observations), None),
    )


def _shown(
    *,
    trunk: str,
    start: tuple[float, float, float] | None,
    pictures: Sequence[str],
    targets: Sequence[str],
    seen: tuple[Line, ...],
    observation: str | None,
) -> Shown:
    leg = tuple(
        Line(topic="/nw/policy", field=f"targets[{number}]", label=joint)
        for number, joint in enumerate(targets[:_LEG])
    )
    plots = (
        _VELOCITY,
        Plot(title="Joint targets", lines=leg),
        Plot(title="What the policy was given", lines=seen),
    )
    return Shown(
        trunk=trunk,
        start=start,
        pictures=tuple(pictures[:_MOST_PICTURES]),
        plots=tuple(plot for plot in plots if plot.lines),
        observation=observation,
    )


def _lines(topic: str, sizes: Sequence[tuple[str, int]], names: Sequence[str]) -> tuple[Line, ...]:
    """Return the first numbers of an observation."""
    pairs = list(zip(value_paths(sizes), names, strict=False))[:_MOST_LINES]
    return tuple(Line(topic=topic, field=field, label=name) for field, name in pairs)


def _sizes(observation: Any) -> list[tuple[str, int]]:
    return [(term.name, len(term.values)) for term in observation.terms]


_PLOT = {
    "showLegend": True,
    "legendDisplay": "floating",
    "showPlotValuesInLegend": True,
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "isSynced": True,
    "xAxisVal": "timestamp",
    "sidebarDimension": 240,
}
_COLOURED_POINTS = {"visible": True, "colorMode": "rgba-fields", "pointSize": 4}


def layout_json(shown: Shown) -> str:
    """Return a layout as the text of a file that both programs import."""
    return json.dumps(layout(shown), indent=2) + "\n"


def layout(shown: Shown) -> dict[str, Any]:
    """Return a layout as what its JSON says."""
    panels: dict[str, dict[str, Any]] = {
        "3D!place": {
            "cameraState": {
                "perspective": True,
                "distance": 4.0,
                "phi": 60.0,
                "thetaOffset": 120.0,
                "target": [0, 0, 0],
                "targetOffset": [0, 0, 0],
                "targetOrientation": [0, 0, 0, 1],
                "fovy": 45,
                "near": 0.1,
                "far": 1000,
            },
            "followMode": "follow-position",
            "followTf": shown.trunk,
            # Small axes: `axisSize` is Foxglove's word for Lichtblick's `axisScale`.
            "scene": {"transforms": {"showLabel": False, "axisSize": 0.1, "axisScale": 0.1}},
            "topics": {
                "/scene": {"visible": True, "showOutlines": False},
                "/waypoints": {"visible": True, "showOutlines": False},
                "/robot/path": _COLOURED_POINTS,
            },
            "layers": {},
        },
        "RosOut!events": {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []},
    }
    for number, plot in enumerate(shown.plots):
        panels[f"Plot!{number}"] = _plot(plot)
    if shown.observation is not None:
        panels["RawMessages!observation"] = {
            "topicPath": shown.observation,
            "diffEnabled": False,
        }
    images = {
        f"Image!{number}": {"imageMode": {"imageTopic": topic}}
        for number, topic in enumerate(shown.pictures)
    }
    left = ("3D!place", "RosOut!events")
    right = [*images, *(name for name in panels if name not in left)]
    return {
        "configById": {**panels, **images},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "first": _stacked(left, shares=(78.0,)),
            "second": _stacked(right),
            "direction": "row",
            "splitPercentage": 62.0,
        },
    }


def _plot(plot: Plot) -> dict[str, Any]:
    series = [
        {
            "value": f"{line.topic}.{line.field}",
            "enabled": True,
            "timestampMethod": "receiveTime",
            **({"label": line.label} if line.label else {}),
        }
        for line in plot.lines
    ]
    return {**_PLOT, "foxglovePanelTitle": plot.title, "paths": series}


def _stacked(names: Sequence[str], shares: Sequence[float] = ()) -> Any:
    """Return panels from top to bottom, of equal height unless `shares` (%) says otherwise."""
    *above, last = names
    sizes = shares or [100.0 / (len(names) - k) for k in range(len(above))]

    def split(below: Any, item: tuple[str, float]) -> Any:
        name, size = item
        return {"first": name, "second": below, "direction": "column", "splitPercentage": size}

    return reduce(split, reversed(list(zip(above, sizes, strict=True))), last)
