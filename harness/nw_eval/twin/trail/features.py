"""What a trail leads over: hurdles, gaps, slopes, leaning boards and stairs, each with its size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nw_eval.twin.trail.ground import GroundProfile
from nw_eval.twin.trail.stretches import Stretch
from nw_eval.twin.trail.way import STEP
from nw_eval.words import Task

_LONGEST_BAR = 0.9
"""Of a hurdle along the way, metres; what is longer is a platform."""
_WIDEST_GAP = 1.3
"""That a robot is asked to leap, metres."""
_ALIKE = 0.06
"""Two heights that differ by less are the same ground, metres."""
_STEPS = 3
"""Edges one way that make a flight of stairs."""
_LONGEST_TREAD = 1.6
"""Landings within a flight included, metres."""
_TALLEST_STEP = 0.28
_LEAN = math.tan(math.radians(6.0))
_LEAST_BOARD = 0.4
"""Of a board that leans to a side, metres along the way."""


@dataclass(frozen=True, kw_only=True)
class TrailFeature:
    """One thing that a trail leads over. Lengths in metres along the way.

    Attributes:
        task: whose scenes have such things.
        start, end: along the way.
        stands: where along the way a robot stands on it, in order: bars' tops, treads, decks, or
            what lies behind a gap.
        size: height of a bar or a flight, width of a gap, metres; or angle of a slope, degrees.
        words: what it is, for people.
    """

    task: Task
    start: float
    end: float
    stands: tuple[float, ...]
    size: float
    words: str


def features_of(profile: GroundProfile, stretches: Sequence[Stretch]) -> list[TrailFeature]:
    """Return what a profile leads over, in order.

    A flight of stairs is three edges one way or more with treads between them; a hurdle goes up and
    down again within 0.9 m, a gap down and up again within 1.3 m, to about the same height. So bars
    on the ground are no gaps: of the two readings, ground is what lies at the height of the start.
    """
    flights = _flights(stretches)
    taken = [(flight.start, flight.end) for flight in flights]
    free = [s for s in stretches if not any(a <= s.middle <= b for a, b in taken)]
    boards = _boards(profile)
    # A board that leans has edges before and behind it; that makes no bar of it.
    level = [
        feature
        for feature in _bars_and_gaps(free)
        if not any(b.start < feature.stands[0] < b.end for b in boards)
        and not any(feature.start < b.stands[0] < feature.end for b in boards)
    ]
    found = [*flights, *level, *_slopes(free), *boards]
    return sorted(found, key=lambda feature: feature.start)


def _flights(stretches: Sequence[Stretch]) -> list[TrailFeature]:
    edges = [s for s in stretches if s.kind == "edge"]
    groups: list[list[Stretch]] = []
    for edge in edges:
        last = groups[-1][-1] if groups else None
        follows = (
            last is not None
            and edge.rise * last.rise > 0
            and edge.start - last.end <= _LONGEST_TREAD
            and max(abs(edge.rise), abs(last.rise)) <= _TALLEST_STEP
        )
        if follows:
            groups[-1].append(edge)
        else:
            groups.append([edge])
    return [_flight(group) for group in groups if len(group) >= _STEPS]


def _flight(edges: Sequence[Stretch]) -> TrailFeature:
    rises = [abs(edge.rise) for edge in edges]
    treads = tuple((a.end + b.start) / 2 for a, b in pairwise(edges))
    way = "up" if edges[0].rise > 0 else "down"
    return TrailFeature(
        task="stairs",
        start=edges[0].start,
        end=edges[-1].end,
        stands=treads[::2],
        size=sum(rises),
        words=f"{len(edges)} steps {way}, {sum(rises) / len(rises):.2f} m each",
    )


def _bars_and_gaps(stretches: Sequence[Stretch]) -> list[TrailFeature]:
    levels = [s for s in stretches if s.kind == "level"]
    ground = levels[0].before if levels else 0.0
    edges = [s for s in stretches if s.kind == "edge"]
    found: list[TrailFeature] = []
    for first, second in pairwise(edges):
        alike = abs(first.before - second.after) <= max(_ALIKE, 0.3 * abs(first.rise))
        apart = second.start - first.end
        at, beside = (first.start, second.end), abs(first.before - ground)
        if not alike or first.rise * second.rise >= 0:
            continue
        if first.rise > 0 and apart <= _LONGEST_BAR and beside <= _ALIKE:
            found.append(_bar(first, second))
        elif first.rise < 0 and apart <= _WIDEST_GAP and beside <= _ALIKE:
            behind = [s for s in levels if s.start >= at[1] - STEP]
            found.append(_gap(first, second, behind[0] if behind else None))
    return found


def _bar(up: Stretch, down: Stretch) -> TrailFeature:
    height = max(up.rise, -down.rise)
    return TrailFeature(
        task="hurdles",
        start=up.start,
        end=down.end,
        stands=((up.end + down.start) / 2,),
        size=height,
        words=f"a bar {height:.2f} m high and {down.start - up.end:.2f} m long",
    )


def _gap(down: Stretch, up: Stretch, behind: Stretch | None) -> TrailFeature:
    width = up.end - down.start
    # On the middle of a platform, or where a long one has been gained.
    stand = up.end + 0.5 if behind is None else min(behind.middle, behind.start + 1.2)
    return TrailFeature(
        task="gaps",
        start=down.start,
        end=up.end,
        stands=(stand,),
        size=width,
        words=f"a gap {width:.2f} m wide and {-down.rise:.2f} m deep",
    )


def _slopes(stretches: Sequence[Stretch]) -> list[TrailFeature]:
    """Return slopes along the way; one that leads up is stood on behind its crest."""
    found: list[TrailFeature] = []
    for number, stretch in enumerate(stretches):
        if stretch.kind != "slope":
            continue
        degrees = math.degrees(math.atan2(abs(stretch.rise), stretch.length))
        following = stretches[number + 1] if number + 1 < len(stretches) else None
        crest = stretch.end
        if following is not None and following.kind == "level":
            crest = min(following.middle, following.start + 0.6)
        found.append(
            TrailFeature(
                task="ramps",
                start=stretch.start,
                end=stretch.end,
                stands=(crest,) if stretch.rise > 0 else (),
                size=degrees,
                words=f"a slope {'up' if stretch.rise > 0 else 'down'} of {degrees:.0f} degrees "
                f"over {stretch.length:.2f} m",
            )
        )
    return found


def _boards(profile: GroundProfile) -> list[TrailFeature]:
    """Return what leans to a side."""
    leans = np.where(np.abs(profile.lean) >= _LEAN, np.sign(profile.lean), 0.0)
    breaks = np.flatnonzero(np.diff(leans, prepend=0.0, append=0.0)).tolist()
    found: list[TrailFeature] = []
    for first, last in pairwise(breaks):
        length = STEP * (last - 1 - first)
        if leans[first] == 0 or length < _LEAST_BOARD:
            continue
        degrees = math.degrees(math.atan(abs(float(np.median(profile.lean[first:last])))))
        side = "right" if leans[first] > 0 else "left"
        found.append(
            TrailFeature(
                task="ramps",
                start=STEP * first,
                end=STEP * (last - 1),
                stands=(STEP * (first + last - 1) / 2,),
                size=degrees,
                words=f"a board that leans {degrees:.0f} degrees down to the {side}",
            )
        )
    return found
