"""The page of a training: success and limits over its steps, and a line for each checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from nw_eval.reporting.html.environment import render

if TYPE_CHECKING:
    from nw_gate.limits.ladder import Ladder

NO_LADDERS: Mapping[str, Ladder] = MappingProxyType({})
"""Where a suite's gate names none."""
_LEFT, _ACROSS, _FLOOR, _UP = 48.0, 620.0, 220.0, 200.0
"""Of the drawing of a training: where its axes begin, and how long they are."""


def render_training(
    title: str,
    suite: str,
    checkpoints: Sequence[Mapping[str, Any]],
    *,
    best: int | None,
    confidence: float,
    obstacles: Sequence[str] = (),
    ladders: Mapping[str, Ladder] = NO_LADDERS,
) -> str:
    """Return the page of a training: success and limits over its steps, a line per checkpoint.

    Args:
        title: the training's name.
        suite: the suite's name.
        checkpoints: in order of their steps, as `nw_eval.WatchedCheckpoint` has them.
        best: the step of the one with the largest mean success.
        confidence: of each bound of success.
        obstacles: why no checkpoint can PASS beside one that never fails, a sentence each.
        ladders: that the suite's gate names, by name.
    """
    used = [each for each in checkpoints if each["success"] is not None]
    steps = [each["step"] for each in used]
    first, last = (min(steps), max(steps)) if steps else (0, 0)
    across = max(1, last - first)
    points = [
        {
            "x": round(_LEFT + _ACROSS * (each["step"] - first) / across, 1),
            "y": round(_FLOOR - _UP * each["success"], 1),
            "low": round(_FLOOR - _UP * each["low"], 1),
            "high": round(_FLOOR - _UP * each["high"], 1),
            "verdict": each["verdict"],
            "is_best": each["step"] == best,
        }
        for each in used
    ]
    return render(
        "training.html.j2",
        training=title,
        suite=suite,
        checkpoints=checkpoints,
        points=points,
        first=first,
        last=last,
        best=best,
        confidence=confidence,
        obstacles=obstacles,
        scores=tuple(dict.fromkeys(name for each in checkpoints for name in each["scores"])),
        limits=[
            _limit_curve(name, ladder, used, lambda step: (step - first) / across)
            for name, ladder in ladders.items()
            if any(name in each["limits"] for each in used)
        ],
    )


@dataclass(frozen=True, kw_only=True)
class LimitCurve:
    """A ladder over the steps of a training, in units of its drawing: harder is higher."""

    name: str
    easiest: str
    hardest: str
    points: tuple[tuple[float, float, float, str], ...]
    """x, y of what is cleared, y of what is not, and both in words."""


def _limit_curve(
    name: str,
    ladder: Ladder,
    checkpoints: Sequence[Mapping[str, Any]],
    along: Callable[[int], float],
) -> LimitCurve:
    values = ladder.rungs
    easiest, width = values[0], values[-1] - values[0]

    def y(value: float | None, beyond: float) -> float:
        share = beyond if value is None else (value - easiest) / width
        return round(_FLOOR - _UP * share, 1)

    known = [each for each in checkpoints if name in each["limits"]]
    return LimitCurve(
        name=name,
        easiest=ladder.says(easiest),
        hardest=ladder.says(values[-1]),
        points=tuple(
            (
                round(_LEFT + _ACROSS * along(each["step"]), 1),
                y(low, -_OFF),
                y(high, 1.0 + _OFF),
                f"step {each['step']}: {_said(ladder, low)} cleared, {_said(ladder, high)} not",
            )
            for each in known
            for low, high in [each["limits"][name]]
        ),
    )


def _said(ladder: Ladder, value: float | None) -> str:
    return "no rung" if value is None else ladder.says(value)


_OFF = 0.04
"""How far beyond the ladder's ends a bound is drawn that lies off it, as a share of its height."""
