"""Success over training steps or dates, drawn: a line for each policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from nw_eval.stats.interval import Interval

WIDTH, HEIGHT = 760, 270
LEFT, RIGHT, TOP, FLOOR = 46.0, 560.0, 12.0, 232.0
"""Of the axes: names of lines stand to the right of them."""
STYLES = 6
"""Colours; the next lines have these again, dashed."""
MOST = 14
"""Lines of a drawing, which names have room beside."""
_NAME = 26  # characters of a name beside its line
_LINE = 15.0  # between two names
_TICKS = 5


@dataclass(frozen=True, kw_only=True)
class Result:
    """A run in a drawing.

    Attributes:
        at: the training step, or s since 1970.
        success: the mean, in [0, 1].
        interval: its bounds.
        name: of the run; it says the step of one.
    """

    at: float
    success: float
    interval: Interval
    name: str


@dataclass(frozen=True, kw_only=True)
class DrawnResult:
    """A point, in units of the drawing."""

    x: float
    y: float
    low: float
    high: float
    says: str
    """Shown beside it when a pointer is over it."""


@dataclass(frozen=True, kw_only=True)
class DrawnLine:
    """A policy's results in order, and its name beside the last one."""

    name: str
    style: int
    """Which of the colours, from 0."""
    dashed: bool
    points: tuple[DrawnResult, ...]
    name_y: float


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A drawing. `axis` says what goes to the right; `left_out` counts policies without room."""

    axis: str
    ticks: tuple[tuple[float, str], ...]
    lines: tuple[DrawnLine, ...]
    left_out: int


def chart(axis: str, results: Sequence[tuple[str, Sequence[Result]]]) -> Chart | None:
    """Return the drawing of several policies' results; None without any.

    Args:
        axis: `training step` or `date`.
        results: names and results of policies, those first that are to be drawn if there are more
            than `MOST`.
    """
    kept = [(name, sorted(found, key=lambda each: each.at)) for name, found in results if found]
    if not kept:
        return None
    drawn = kept[:MOST]
    times = [each.at for _, found in drawn for each in found]
    first, last = min(times), max(times)

    def x(at: float) -> float:
        share = (at - first) / (last - first) if last > first else 0.5
        return round(LEFT + (RIGHT - LEFT) * share, 1)

    says = _date if axis == "date" else _nothing
    lines = [
        DrawnLine(
            name=name if len(name) <= _NAME else f"{name[: _NAME - 3]}...",
            style=place % STYLES,
            dashed=place >= STYLES,
            points=tuple(_point(each, x, says) for each in found),
            name_y=0.0,
        )
        for place, (name, found) in enumerate(drawn)
    ]
    marks = _steps(first, last) if axis == "training step" else _dates(first, last)
    return Chart(
        axis=axis,
        ticks=tuple((x(at), text) for at, text in marks),
        lines=tuple(_named(lines)),
        left_out=len(kept) - len(drawn),
    )


def _point(each: Result, x: Callable[[float], float], says: Callable[[float], str]) -> DrawnResult:
    low, high = (_y(bound) for bound in (each.interval.low, each.interval.high))
    text = f"{each.name}{says(each.at)}: success {each.success:.3f}"
    return DrawnResult(x=x(each.at), y=_y(each.success), low=low, high=high, says=text)


def _y(share: float) -> float:
    return round(FLOOR - (FLOOR - TOP) * share, 1)


def _named(lines: Sequence[DrawnLine]) -> list[DrawnLine]:
    """Return lines whose names stand as near to their last points as they do without touching."""
    order = sorted(range(len(lines)), key=lambda i: (lines[i].points[-1].y, i))
    heights = [lines[i].points[-1].y + 4.0 for i in order]
    for i in range(1, len(heights)):  # Downwards, then back up.
        heights[i] = max(heights[i], heights[i - 1] + _LINE)
    most = FLOOR + 8.0
    for i in range(len(heights) - 1, -1, -1):
        heights[i] = min(heights[i], most)
        most = heights[i] - _LINE
    at = dict(zip(order, heights, strict=True))
    return [replace(line, name_y=round(at[i], 1)) for i, line in enumerate(lines)]


def _steps(first: float, last: float) -> list[tuple[float, str]]:
    """Return round numbers from the first step to the last one, each with its text."""
    if last <= first:
        return [(first, f"{first:.0f}")]
    units = (factor * 10**k for k in range(16) for factor in (1, 2, 5))
    unit = next(unit for unit in units if (last - first) / unit <= _TICKS)
    least = -(-first // unit)
    found = [unit * (least + i) for i in range(int((last - least * unit) // unit) + 1)]
    return [(at, f"{at:.0f}") for at in found]


def _nothing(_: float) -> str:
    return ""


def _date(at: float) -> str:
    return f", {datetime.fromtimestamp(at, UTC):%Y-%m-%d %H:%M} UTC"


def _dates(first: float, last: float) -> list[tuple[float, str]]:
    """Return times from the first to the last, as far apart from each other, each with its text."""
    if last <= first:
        return [(first, f"{datetime.fromtimestamp(first, UTC):%Y-%m-%d}")]
    form = "%Y-%m-%d" if last - first > 4 * 86400 else "%m-%d %H:%M"
    found = [first + (last - first) * i / (_TICKS - 1) for i in range(_TICKS)]
    return [(at, f"{datetime.fromtimestamp(at, UTC):{form}}") for at in found]
