"""A layout of Foxglove and Lichtblick for logs: what to look at when one is opened.

The format is the one that both programs export and import (`configById`, and `layout`, a tree of
panels). Paths of plots are message paths: https://docs.foxglove.dev/docs/visualization.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.viewing.shown import Plot, Shown

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
