"""What a page draws, as numbers: its templates only lay them out.

The two numbers of a verdict on an axis each (`gauges`); where on the course it fails, who came how
far and who missed which waypoint (`course`); and a scene from above, what stands there, its
waypoints, and where trials went and ended (`plan_views`). One trial over time (`timeline`): the
speed of the trunk's origin in the plane, from its walked path, waypoints, contacts and the end.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.reporting.headline import confidence
from nw_eval.reporting.html.evidence import LogEvidence, PlacePicture, PlaceView, WalkedPath
from nw_gate.results.baseline import Start
from nw_gate.results.row import Row
from nw_gate.stats.hazard import Ends, Hazard, differences_over, hazards
from nw_gate.stats.interval import Interval, wilson
from nw_gate.verdict import Comparison, SceneDrop, Verdict, percent_sure

WIDTH = 340.0
"""Of a gauge's axis, in units of its drawing."""


@dataclass(frozen=True, kw_only=True)
class Tick:
    """A value on an axis that something is held against."""

    value: float
    label: str


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """A number with its interval on an axis."""

    title: str
    sentence: str
    axis: Interval
    value: float
    interval: Interval
    good: Literal["low", "high"]
    """Which end of the axis is the better one."""
    ticks: tuple[Tick, ...]

    def x(self, value: float) -> float:
        """Return where a value lies on the axis, 0 to `WIDTH`."""
        share = (value - self.axis.low) / (self.axis.high - self.axis.low)
        return round(WIDTH * min(1.0, max(0.0, share)), 1)

    @property
    def zones(self) -> tuple[tuple[float, float, str], ...]:
        """Left edge, width and kind, `good`, `open` or `bad`, of each part of the axis."""
        edges = [0.0, *(self.x(tick.value) for tick in self.ticks), WIDTH]
        kinds = _KINDS[len(self.ticks)]
        kinds = kinds if self.good == "low" else kinds[::-1]
        return tuple(
            (left, round(right - left, 1), kind)
            for left, right, kind in zip(edges, edges[1:], kinds, strict=False)
        )


_KINDS = (("open",), ("good", "bad"), ("good", "open", "bad"))
"""Of the parts of an axis that no tick, one or two divide, the lower end being the better one."""


def gauges(verdict: Verdict) -> tuple[Gauge, ...]:
    """Return what a verdict rests on, the drop first; none without results."""
    drop = None if verdict.against is None else _drop(verdict.against)
    success = _success(verdict)
    return tuple(gauge for gauge in (drop, success) if gauge is not None)


def _drop(found: Comparison) -> Gauge | None:
    if found.drop is None or found.interval is None:
        return None
    ends = (found.interval.low, found.interval.high, found.max_drop, -found.tolerate, 0.0)
    room = 0.08 * (max(ends) - min(ends))
    return Gauge(
        title=f"Drop against {found.baseline_name} ({percent_sure(found.alpha_regr)} lower, "
        f"{percent_sure(found.alpha_pass)} upper)",
        sentence=f"Mean success fell by {found.drop:z.3f}: by at least "
        f"{found.interval.low:z.3f} ({percent_sure(found.alpha_regr)}) and at most "
        f"{found.interval.high:z.3f} ({percent_sure(found.alpha_pass)}). Up to {found.tolerate:g} "
        f"is tolerated; {found.max_drop:g} must not pass.",
        axis=Interval(min(ends) - room, max(ends) + room),
        value=found.drop,
        interval=found.interval,
        good="low",
        ticks=(
            Tick(value=found.tolerate, label=f"tolerated {found.tolerate:g}"),
            Tick(value=found.max_drop, label=f"max_drop {found.max_drop:g}"),
        ),
    )


def _success(verdict: Verdict) -> Gauge | None:
    if verdict.success is None:
        return None
    bar = () if verdict.bar is None else (Tick(value=verdict.bar, label=f"bar {verdict.bar:g}"),)
    against = "no bar" if verdict.bar is None else f"the bar is {verdict.bar:g}"
    return Gauge(
        title=f"Mean success, new initial states ({confidence(verdict)} lower, "
        f"{confidence(verdict)} upper)",
        sentence=f"Mean success is {verdict.success:.3f}, for new initial states from "
        f"{verdict.interval.low:.3f} to {verdict.interval.high:.3f} ({confidence(verdict)} each "
        f"side); {against}.",
        axis=Interval(0.0, 1.0),
        value=verdict.success,
        interval=verdict.interval,
        good="high",
        ticks=bar,
    )


_LEVELS = (0.0, 0.1, 0.25, 0.5, 0.75)
"""Shares of trials over which a cell is drawn one step stronger."""


@dataclass(frozen=True, kw_only=True)
class Missed:
    """A waypoint in one scene."""

    candidate: Hazard
    baseline: Hazard | None = None
    parted: bool = False
    """Whether the candidate differs significantly from the baseline here."""

    @property
    def level(self) -> int:
        """How strongly to draw it, from 0, no trial missed it, to 5."""
        return sum((self.candidate.share or 0.0) > least for least in _LEVELS)


@dataclass(frozen=True, kw_only=True)
class SceneCourse:
    """A scene, waypoint by waypoint."""

    scene: str
    name: str
    """With what was changed there."""
    waypoints: tuple[Missed, ...]


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """The first, second, .. waypoint of all scenes that have so many."""

    candidate: Hazard
    survived: float
    """Share, of all trials that started there, that reached it."""
    baseline: Hazard | None = None
    baseline_survived: float | None = None
    difference: Interval | None = None
    """Of the shares that missed it: the candidate's less the baseline's, this waypoint alone."""


@dataclass(frozen=True, kw_only=True)
class FailingCourse:
    """All scenes, the one that lost most first, and all of them together."""

    scenes: tuple[SceneCourse, ...]
    together: tuple[Waypoint, ...]
    baseline: str = ""
    """What the baseline is, in words; empty without one."""

    @property
    def order(self) -> tuple[str, ...]:
        """Scenes in that order."""
        return tuple(dict.fromkeys(each.scene for each in self.scenes))

    @property
    def compared(self) -> bool:
        """Whether there is a baseline beside it."""
        return any(each.baseline is not None for each in self.together)


def course(rows: Sequence[Row], verdict: Verdict) -> FailingCourse:
    """Return where trials ended.

    Against a baseline it is what the gate compared, the trials judged beside all starts of the
    baseline; else it is all trials with a result.
    """
    against = () if verdict.against is None else verdict.against.scenes
    judged = [item for item in against if item.ends is not None and sum(item.ends[1])]
    if judged:
        scenes = [_compared(item, *item.ends) for item in judged if item.ends is not None]
        together = _together_compared([item.ends for item in judged if item.ends is not None])
    else:
        ends = _ends(rows)
        scenes = [
            SceneCourse(
                scene=scene,
                name=scene,
                waypoints=tuple(Missed(candidate=each) for each in hazards(found)),
            )
            for scene, found in ends.items()
        ]
        together = _together(list(ends.values()))
    scenes.sort(key=lambda scene: (-_lost(scene), scene.name))
    return FailingCourse(
        scenes=tuple(scenes), together=together, baseline=_baseline(verdict) if judged else ""
    )


def _baseline(verdict: Verdict) -> str:
    """Return which trials of the baseline the candidate's stand beside."""
    if verdict.against is not None and verdict.against.basis == "control":
        return "those of its policy that ran beside the candidate"
    return "all initial states of the baseline"


def survived(ends: Sequence[Ends], waypoint: int) -> float:
    """Return which share, of the trials in scenes with so many waypoints, reached one."""
    here = [each for each in ends if len(each) > waypoint]
    return sum(sum(each[waypoint:]) for each in here) / max(1, sum(map(sum, here)))


def _ends(rows: Sequence[Row]) -> dict[str, Ends]:
    found: dict[str, Ends] = {}
    results: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row.status == "ok":
            results[row.scene].append(row)
    for scene, here in sorted(results.items()):
        total = max((row.waypoints_total for row in here), default=0)
        if total:
            reached = np.bincount([row.waypoints_reached for row in here], minlength=total + 1)
            found[scene] = [int(count) for count in reached]
    return found


def _compared(item: SceneDrop, baseline: Ends, candidate: Ends) -> SceneCourse:
    pairs = zip(hazards(baseline), hazards(candidate), strict=True)
    return SceneCourse(
        scene=item.scene,
        name=item.name,
        waypoints=tuple(
            Missed(candidate=two, baseline=one, parted=two.waypoint == item.waypoint)
            for one, two in pairs
        ),
    )


def _together_compared(pairs: Sequence[tuple[Ends, Ends]]) -> tuple[Waypoint, ...]:
    one, two = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return tuple(
        Waypoint(
            candidate=each.second,
            survived=survived(two, each.waypoint),
            baseline=each.first,
            baseline_survived=survived(one, each.waypoint),
            difference=each.interval if each.second.trials else None,
        )
        for each in differences_over(pairs)
    )


def _together(ends: Sequence[Ends]) -> tuple[Waypoint, ...]:
    found: list[Waypoint] = []
    for k in range(1, max(map(len, ends), default=1)):
        here = [each for each in ends if len(each) > k]
        failed, trials = sum(each[k - 1] for each in here), sum(sum(each[k - 1 :]) for each in here)
        hazard = Hazard(
            waypoint=k, trials=trials, failed=failed, interval=wilson(failed, trials, 0.95)
        )
        found.append(Waypoint(candidate=hazard, survived=survived(ends, k)))
    return tuple(found)


def _lost(scene: SceneCourse) -> float:
    """Return which share of a scene's trials did not reach its last waypoint."""
    first, last = scene.waypoints[0].candidate, scene.waypoints[-1].candidate
    return 1.0 - (last.trials - last.failed) / max(1, first.trials)


_STEP = 8.0
"""Centimetres: what of a path is closer to its last point is left out."""
_ROOM = 60.0
"""Centimetres around waypoints and paths."""
_LEAST = 200.0
"""Centimetres that a view is wide and high at least."""


Points = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class DrawnPath:
    """One trial's path, in the view's units."""

    trial_id: str
    outcome: str
    text: str
    """How it ended, for whoever points at it."""
    d: str
    """As SVG's `path` takes it."""
    end: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class DrawnPicture:
    """A picture of the scene and where it lies."""

    picture: PlacePicture
    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, kw_only=True)
class PlanView:
    """A view whose unit is a centimetre: x to the right, y down, so north is up."""

    scene: str
    box: tuple[int, int, int, int]
    """x, y, width and height."""
    waypoints: tuple[tuple[int, int], ...]
    reach: int
    outlines: tuple[str, ...]
    """As SVG's `polygon` takes them."""
    picture: DrawnPicture | None
    note: str
    paths: tuple[DrawnPath, ...]
    """Those that completed first, so that the others lie above them."""

    @property
    def unit(self) -> float:
        """Of what must keep its size whatever the scene's: a hundredth of the larger side."""
        return max(self.box[2:]) / 100


def plan_views(
    rows: Iterable[Row], evidence: LogEvidence, pictures: Mapping[str, PlacePicture]
) -> dict[str, PlanView]:
    """Return the view of every scene of which a log shows place or paths.

    Args:
        rows: of the run; paths of trials that it does not have are left out.
        evidence: what the logs hold.
        pictures: of scenes, as many as the page has room for.
    """
    trials = {row.trial_id: row for row in rows}
    walked: dict[str, list[tuple[Row, WalkedPath]]] = {}
    for path in evidence.paths:
        if path.trial_id in trials and len(path.points) and np.isfinite(path.points).all():
            row = trials[path.trial_id]
            walked.setdefault(row.scene, []).append((row, path))
    places = {place.scene: place for place in evidence.places}
    scenes = {row.scene for row in trials.values()} & {*walked, *places}
    return {
        scene: _view(scene, places.get(scene), walked.get(scene, []), pictures.get(scene))
        for scene in sorted(scenes)
    }


def _view(
    scene: str,
    place: PlaceView | None,
    walked: Sequence[tuple[Row, WalkedPath]],
    picture: PlacePicture | None,
) -> PlanView:
    ordered = sorted(walked, key=lambda pair: (not pair[0].completed, pair[0].trial_id))
    waypoints = np.zeros((0, 2)) if place is None else place.waypoints.reshape(-1, 2)
    reach = None if place is None else place.reach
    return PlanView(
        scene=scene,
        box=_box([waypoints, *(path.points for _, path in walked)]),
        waypoints=tuple(_pairs(waypoints)),
        reach=0 if reach is None else round(100 * reach),
        outlines=() if place is None else tuple(_polygon(each) for each in place.outlines),
        picture=None if picture is None else _placed(picture),
        note="" if place is None else place.note,
        paths=tuple(_drawn(row, path.points) for row, path in ordered),
    )


def _units(points: Points) -> NDArray[np.int64]:
    return np.rint(points * (100.0, -100.0)).astype(np.int64)


def _pairs(points: Points) -> list[tuple[int, int]]:
    return [(x, y) for x, y in _units(points).tolist()]


def _box(shapes: Sequence[Points]) -> tuple[int, int, int, int]:
    points = np.concatenate([_units(shape) for shape in shapes])
    points = points if len(points) else np.zeros((1, 2))
    low, high = points.min(axis=0) - _ROOM, points.max(axis=0) + _ROOM
    lack = np.maximum(_LEAST - (high - low), 0.0) / 2
    low, high = low - lack, high + lack
    x, y, width, height = (*low.tolist(), *(high - low).tolist())
    return round(x), round(y), round(width), round(height)


def _polygon(points: Points) -> str:
    return " ".join(f"{x},{y}" for x, y in _pairs(points))


def _placed(picture: PlacePicture) -> DrawnPicture:
    (x, y), (right, bottom) = _pairs(
        np.array([[picture.west, picture.north], [picture.east, picture.south]])
    )
    return DrawnPicture(picture=picture, x=x, y=y, width=right - x, height=bottom - y)


def _drawn(row: Row, points: Points) -> DrawnPath:
    thinned = _thinned(_pairs(points))
    steps = [(x - a, y - b) for (a, b), (x, y) in pairwise(thinned)]
    moves = "".join(f"l{dx} {dy}" for dx, dy in steps)
    return DrawnPath(
        trial_id=row.trial_id,
        outcome=row.outcome,
        text=f"{row.trial_id}: {row.outcome}, {row.standing}",
        d=f"M{thinned[0][0]} {thinned[0][1]}{moves}",
        end=thinned[-1],
    )


def _thinned(points: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    kept = [points[0]]
    for x, y in points[1:]:
        if hypot(x - kept[-1][0], y - kept[-1][1]) >= _STEP:
            kept.append((x, y))
    return kept if kept[-1] == points[-1] else [*kept, points[-1]]


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
