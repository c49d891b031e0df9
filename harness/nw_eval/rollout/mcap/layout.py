"""A layout of Foxglove and Lichtblick for the logs of one run: what to look at when one is opened.

The format is the one that both programs export and import (`configById`, and `layout`, a tree of
panels). Paths of plots are message paths: https://docs.foxglove.dev/docs/visualization.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

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
_MOST_PICTURES = 3
_VELOCITY = (
    "/robot/command.forward",
    "/robot/twist.linear.x",
    "/robot/command.yaw_rate",
    "/robot/twist.angular.z",
    "/robot/command.heading_error",
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a plot."""

    path: str
    """Topic and field: a message path."""
    label: str = ""
    """Its name in the legend; empty = the path."""


def layout_json(
    *,
    trunk: str,
    pictures: Sequence[str],
    targets: Sequence[Line],
    seen: Sequence[Line],
    observation: str | None,
) -> str:
    """Return a layout as JSON.

    Args:
        trunk: the frame that the view follows.
        pictures: topics of images; the first few get a panel each.
        targets: some of the joints' targets.
        seen: some of the numbers that the policy was given.
        observation: a topic of such numbers that is shown in full.
    """
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
            "followTf": trunk,
            # Small axes: `axisSize` is Foxglove's word for Lichtblick's `axisScale`.
            "scene": {"transforms": {"showLabel": False, "axisSize": 0.1, "axisScale": 0.1}},
            "topics": {
                "/scene": {"visible": True, "showOutlines": False},
                "/waypoints": {"visible": True, "showOutlines": False},
                "/robot/path": _COLOURED_POINTS,
            },
            "layers": {},
        },
        "Plot!velocity": _plot(
            "Velocity, commanded and measured",
            *(Line(path=path) for path in _VELOCITY),
        ),
        "Plot!joints": _plot("Joint targets", *targets),
        "RosOut!events": {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []},
    }
    if seen:
        panels["Plot!observation"] = _plot("What the policy was given", *seen)
    if observation is not None:
        panels["RawMessages!observation"] = {"topicPath": observation, "diffEnabled": False}
    images = {
        f"Image!{number}": {"imageMode": {"imageTopic": topic}}
        for number, topic in enumerate(pictures[:_MOST_PICTURES])
    }
    left = ("3D!place", "RosOut!events")
    right = [*images, *(name for name in panels if name not in left)]
    layout = {
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
    return json.dumps(layout, indent=2) + "\n"


def _plot(title: str, *lines: Line) -> dict[str, Any]:
    series = [
        {
            "value": line.path,
            "enabled": True,
            "timestampMethod": "receiveTime",
            **({"label": line.label} if line.label else {}),
        }
        for line in lines
    ]
    return {**_PLOT, "foxglovePanelTitle": title, "paths": series}


def _stacked(names: Sequence[str], shares: Sequence[float] = ()) -> Any:
    """Return panels from top to bottom, of equal height unless `shares` (%) says otherwise."""
    *above, last = names
    sizes = shares or [100.0 / (len(names) - k) for k in range(len(above))]

    def split(below: Any, item: tuple[str, float]) -> Any:
        name, size = item
        return {"first": name, "second": below, "direction": "column", "splitPercentage": size}

    return reduce(split, reversed(list(zip(above, sizes, strict=True))), last)
