"""A scene from above: what stands there, its waypoints, and where trials went and ended."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot

import numpy as np
from numpy.typing import NDArray

from nw_eval.reporting.html.evidence import LogEvidence, PlacePicture, PlaceView, WalkedPath
from nw_eval.results.row import Row

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
    """A picture of the place and where it lies."""

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
    paths: tuple[DrawnPath, ...]
    """Those that completed first, so that the others lie above them."""

    @property
    def unit(self) -> float:
        """Of what must keep its size whatever the place's: a hundredth of the larger side."""
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
        text=f"{row.trial_id}: {row.outcome}, {row.waypoints_reached}/{row.waypoints_total}",
        d=f"M{thinned[0][0]} {thinned[0][1]}{moves}",
        end=thinned[-1],
    )


def _thinned(points: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    kept = [points[0]]
    for x, y in points[1:]:
        if hypot(x - kept[-1][0], y - kept[-1][1]) >= _STEP:
            kept.append((x, y))
    return kept if kept[-1] == points[-1] else [*kept, points[-1]]
