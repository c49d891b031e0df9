"""One trial over time, as a page draws it: speed, waypoints, contacts and the end.

The speed is that of the trunk's origin in the plane, from the walked path of the trial's log. A
page draws it as a small chart, without a script: templates only lay the numbers out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.reporting.html.evidence import WalkedPath
from nw_gate.results.baseline import Start
from nw_gate.results.row import Row

LEFT, RIGHT, TOP, BOTTOM = 34.0, 352.0, 16.0, 78.0
"""Edges of the plotted area, in units of the drawing."""

_MOST_POINTS = 150
"""Of a line: finer than a pixel of the chart nothing is to be seen."""
_LEAST_SPEED = 0.5
"""Upper end of the speed axis at least, m/s: a robot that stands still draws a flat line."""
_FASTEST = 1000.0
"""m/s from which on a path says nothing: physics diverged, or somebody made it up."""
_STEPS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0, 1800.0)
"""Seconds between two labels of the time axis: the first with at most six labels."""


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """The chart of a trial; `x` and `y` are in units of the drawing."""

    line: str
    """The speed, as SVG's `path` takes it."""
    top_speed: float
    """Upper end of the speed axis, m/s."""
    labels: tuple[tuple[float, str], ...]
    """x and text of the time axis."""
    waypoints: tuple[tuple[float, int], ...]
    """x and number of each waypoint that was reached."""
    baseline_waypoints: tuple[tuple[float, int], ...]
    """The same of the baseline's policy; empty where only its result is known."""
    contacts: tuple[float, ...]
    """x of each contact of head or trunk."""
    end: tuple[float, float]
    """x and y of the end."""
    words: str
    """The chart for those who do not see it."""


def timeline(row: Row, path: WalkedPath, rival: Row | Start | None = None) -> Timeline | None:
    """Return the chart of a trial; None if its path is too short for a speed.

    Args:
        row: of the trial.
        path: where it walked.
        rival: of the baseline's policy from the same initial state. A baseline's result has no
            times; a trial that ran beside the candidate has.
    """
    times, speeds = _speeds(path, row.sim_s)
    if not len(speeds) or not np.isfinite(speeds).all() or speeds.max() > _FASTEST:
        return None
    others = rival.waypoint_times if isinstance(rival, Row) else ()
    span = max(row.sim_s, *others, times[-1], 1e-3)
    top = max(_LEAST_SPEED, float(np.ceil(10.0 * speeds.max())) / 10.0)

    def x(time: float) -> float:
        return round(LEFT + (RIGHT - LEFT) * min(1.0, max(0.0, time / span)), 1)

    def y(speed: float) -> float:
        return round(BOTTOM - (BOTTOM - TOP) * speed / top, 1)

    points = [(x(t), y(v)) for t, v in zip(times.tolist(), speeds.tolist(), strict=True)]
    return Timeline(
        line="M" + "L".join(f"{a:g} {b:g}" for a, b in points),
        top_speed=top,
        labels=tuple((x(t), f"{t:g}") for t in _ticks(span)),
        waypoints=_numbered(row.waypoint_times, x),
        baseline_waypoints=_numbered(others, x),
        contacts=tuple(x(t) for t in path.contacts),
        end=(x(row.sim_s), points[-1][1]),
        words=_words(row, path, float(speeds.mean())),
    )


def _speeds(path: WalkedPath, end: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times, s, and mean speeds until then, m/s, in at most `_MOST_POINTS` steps."""
    points = np.asarray(path.points, dtype=np.float64)
    count = len(points)
    if count < 2 or not np.isfinite(points).all():
        return np.empty(0), np.empty(0)
    times = np.minimum(np.arange(count) * path.period, max(end, path.period))
    lengths = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    kept = np.unique(np.linspace(0, count - 1, min(count, _MOST_POINTS + 1)).round().astype(int))
    lasted = np.diff(times[kept])
    is_step = lasted > 0.25 * path.period  # The last point may lie just behind the one before.
    speeds = np.diff(lengths[kept])[is_step] / lasted[is_step]
    return times[kept][1:][is_step], speeds


def _ticks(span: float) -> list[float]:
    step = next((each for each in _STEPS if span / each <= 6.0), span / 6.0)
    return [step * k for k in range(int(span / step) + 1)]


def _numbered(times: Sequence[float], x: Callable[[float], float]) -> tuple[tuple[float, int], ...]:
    return tuple((x(time), number) for number, time in enumerate(times, 1))


def _words(row: Row, path: WalkedPath, mean: float) -> str:
    parts = [f"Speed over {row.sim_s:.1f} s, {mean:.2f} m/s on average"]
    parts += [f"waypoint {n} at {t:.1f} s" for n, t in enumerate(row.waypoint_times, 1)]
    parts += [f"contact at {path.contacts[0]:.1f} s"] if path.contacts else []
    return ", ".join((*parts, f"{row.outcome} at {row.sim_s:.1f} s")) + "."
