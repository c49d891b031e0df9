"""When the messages of a robot's log were measured, and where the log pauses.

The stamps of headers and the times of logging are checked, each by itself and against each other. A
clock that repeats, was set back, comes in bursts or counts in another unit is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from nw_gate.scores.score import Array

_SET_BACK = 0.05  # s that messages may be out of order
_PAUSE, _INTERVALS = 0.1, 3.0  # A longer interval is a pause: s, and in usual intervals.
_SHORTEST, _LONGEST = 1.0 / 3000.0, 3.0  # s between messages; others count in another unit.
_SAME_CLOCK = 1.0  # s
_STRAY = 0.05  # s between stamps and log times that is noted
_MISSING = "are missing"
Span = tuple[float, float]


class Stamps(NamedTuple):
    """The times of a topic's messages in the order of the file, (N,) s; NaN where there is none."""

    topic: str
    header: Array
    logged: Array
    steady: bool
    """Whether its messages come at a rate, unlike commands of a person."""


def on_one_clock(
    sources: Mapping[str, Stamps], notes: list[str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the times of sources on one clock, and why those of others are not known.

    Stamps of headers are used where they are sound, and log times elsewhere. A topic without stamps
    is put on the clock of one that has them by when both were logged.

    Args:
        sources: by name; of the first with sound stamps the clock is used.
        notes: where clocks disagree is added.
    """
    times, faults = dict[str, Array](), dict[str, str]()
    master: Stamps | None = None
    checked = {name: _faults(each, notes) for name, each in sources.items()}
    for name in sorted(sources, key=lambda name: checked[name][0] != ""):
        each, (stamps, logged) = sources[name], checked[name]
        fault = (
            f"its header stamps {stamps}, and its log times {logged}" if stamps and logged else ""
        )
        own = each.logged if stamps else each.header
        if master is None:
            master = None if stamps else each
        elif (mapped := _mapped(each, master)) is None:
            if stamps:
                fault = f"it has no header stamps, and log times of {master.topic} go back"
        elif stamps or np.nanmedian(np.abs(own - mapped)) > _SAME_CLOCK:
            if not stamps:
                notes.append(
                    f"header stamps of {each.topic} are of another clock than those of "
                    f"{master.topic}; its log times are used"
                )
            own = mapped
            if why := _fault(own, steady=each.steady):
                fault = fault or f"its log times {why}"
            else:
                fault = ""
        if fault:
            faults[name] = fault
        else:
            times[name] = own
    return times, faults


def _mapped(each: Stamps, master: Stamps) -> Array | None:
    """Return log times on the clock of the master's stamps; before and after it as they run."""
    known = np.isfinite(master.header)
    order = np.argsort(master.header[known], kind="stable")
    logged, stamps = master.logged[known][order], master.header[known][order]
    if (np.diff(logged) < -_SET_BACK).any():
        return None
    logged = np.maximum.accumulate(logged)
    before, after = np.minimum(each.logged - logged[0], 0.0), each.logged - logged[-1]
    return np.interp(each.logged, logged, stamps) + before + np.maximum(after, 0.0)


def _faults(each: Stamps, notes: list[str]) -> tuple[str, str]:
    """Return what is wrong with stamps and log times; note where they disagree."""
    stamps, logged = (_fault(times, steady=each.steady) for times in each[1:3])
    if logged and not stamps:
        notes.append(f"log times of {each.topic} {logged}; its header stamps are used")
    elif stamps not in {"", _MISSING} and not logged:
        notes.append(f"header stamps of {each.topic} {stamps}; its log times are used")
    elif not stamps and not logged:
        low, high = np.nanquantile(each.logged - each.header, (0.01, 0.99)).tolist()
        if (stray := high - low) > _STRAY:
            notes.append(
                f"log times of {each.topic} stray by {stray:.3g} s from its header stamps, which "
                "are used"
            )
    return stamps, logged


def _fault(times: Array, *, steady: bool) -> str:
    """Return what is wrong with times in the order of the file; nothing where all is well."""
    known = times[np.isfinite(times)]
    if len(known) < max(0.9 * len(times), 1):
        return _MISSING
    falls = np.flatnonzero(np.diff(known) < 0.0)
    # A file may have another order than time. Stretches that overlap are of a clock set back.
    begins = known[np.concatenate(([0], falls + 1))]
    ends, order = known[np.append(falls, len(known) - 1)], np.argsort(begins, kind="stable")
    overlaps = np.maximum.accumulate(ends[order])[:-1] - begins[order][1:]
    if len(overlaps) and overlaps.max() > _SET_BACK:
        worst = int(falls[np.argmax(known[falls] - known[falls + 1])])
        return f"go back by {known[worst] - known[worst + 1]:.3g} s after message {worst + 1}"
    distinct = np.unique(known)
    if len(distinct) < 0.9 * len(known) and (steady or len(distinct) == 1):
        return "repeat"
    if not steady or len(distinct) < 4:
        return ""
    intervals = np.diff(distinct)
    usual = float(np.median(intervals))
    moving = intervals[intervals < 1.0]
    if len(moving) > 2 and np.quantile(moving, 0.4) < 0.2 * moving.mean():
        return "come in bursts"
    usual = float(np.median(intervals))
    return "" if _SHORTEST < usual < _LONGEST else f"are {usual:.3g} s apart"


def stretches(times: Array) -> tuple[list[Span], float, int]:
    """Return where messages follow each other without a pause.

    Args:
        times: in ascending order, (N,) s.

    Returns:
        Begin and end of each stretch, s; messages a second in them; and how many messages stand
        alone, in none of them.
    """
    intervals = np.diff(times)
    longest = max(_PAUSE, _INTERVALS * float(np.median(intervals))) if len(intervals) else _PAUSE
    cuts = np.flatnonzero(intervals > longest)
    begins, ends = np.concatenate(([0], cuts + 1)), np.append(cuts, len(times) - 1)
    whole = ends > begins
    spans = list(zip(times[begins[whole]].tolist(), times[ends[whole]].tolist(), strict=True))
    seconds = sum(end - begin for begin, end in spans)
    rate = float((ends - begins)[whole].sum()) / seconds if seconds else 0.0
    return spans, rate, int(np.count_nonzero(~whole))


def common(spans: Sequence[Sequence[Span]]) -> list[Span]:
    """Return the stretches that lie in one of each list, s; all are in ascending order."""
    common_spans = list(spans[0])
    for others in spans[1:]:
        shared, place = list[Span](), 0
        for begin, end in common_spans:
            while place < len(others) and others[place][1] <= begin:
                place += 1
            for other in others[place:]:
                if other[0] >= end:
                    break
                shared.append((max(begin, other[0]), min(end, other[1])))
        common_spans = shared
    return common_spans
