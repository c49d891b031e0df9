"""The two numbers of a verdict on an axis each: the drop, and mean success."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from nw_eval.gate.verdict import Comparison, Verdict, percent_sure
from nw_eval.reporting.headline import confidence
from nw_eval.stats.interval import Interval

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
        title=f"Drop against {found.bank} ({percent_sure(found.alpha_regr)} lower, "
        f"{percent_sure(found.alpha_pass)} upper)",
        sentence=f"Mean success fell by {found.drop:z.3f}, from {found.baseline:.3f}: by at least "
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
        title=f"Mean success, fresh starts ({confidence(verdict)} lower, {confidence(verdict)} "
        "upper)",
        sentence=f"Mean success is {verdict.success:.3f}, for fresh starts from "
        f"{verdict.interval.low:.3f} to {verdict.interval.high:.3f} ({confidence(verdict)} each "
        f"side); {against}.",
        axis=Interval(0.0, 1.0),
        value=verdict.success,
        interval=verdict.interval,
        good="high",
        ticks=bar,
    )
