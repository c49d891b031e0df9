"""A layout of Foxglove and Lichtblick for the logs of one run: what to look at when one is opened.

The format is the one that both programs export and import (`configById`, and `layout`, a tree of
panels). Paths of plots are message paths: https://docs.foxglove.dev/docs/visualization.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
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


def layout_json(*, trunk: str, pictures: Sequence[str], observations: Sequence[str]) -> str:
    """Return a layout as JSON.

    Args:
        trunk: the frame that the view follows.
        pictures: topics of images; the first few get a panel each.
        observations: names of those that are numbers; the first is shown in full.
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
            "/robot/command.forward",
            "/robot/twist.linear.x",
            "/robot/command.yaw_rate",
            "/robot/twist.angular.z",
            "/robot/command.heading_error",
        ),
        "Plot!joints": _plot("Joint targets", *(f"/nw/policy.targets[{k}]" for k in range(3))),
        "RosOut!events": {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []},
    }
    if observations:
        topic = f"/observation/{observations[0]}"
        panels["RawMessages!observation"] = {"topicPath": topic, "diffEnabled": False}
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


def _plot(title: str, *paths: str) -> dict[str, Any]:
    series = [{"value": p, "enabled": True, "timestampMethod": "receiveTime"} for p in paths]
    return {**_PLOT, "foxglovePanelTitle": title, "paths": series}


def _stacked(names: Sequence[str], shares: Sequence[float] = ()) -> Any:
    """Return panels from top to bottom, of equal height unless `shares` (%) says otherwise."""
    *above, last = names
    sizes = shares or [100.0 / (len(names) - k) for k in range(len(above))]

    def split(below: Any, item: tuple[str, float]) -> Any:
        name, size = item
        return {"first": name, "second": below, "direction": "column", "splitPercentage": size}

    return reduce(split, reversed(list(zip(above, sizes, strict=True))), last)
