"""Scores by name: those that are built in, and those of installed packages.

What is not built in is looked for among the entry points of `nw_eval.scores`, each a subclass of
`Score` whose `spec` has the name of the entry point. Nothing of a package is imported before a
suite names it. Built-in names always win.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from nw_eval.errors import nearest
from nw_eval.scores import effort, motion, travel
from nw_eval.scores.score import Score, ScoreSpec

SCORES = "nw_eval.scores"
"""The entry-point group."""

_CLASSES: tuple[type[Score], ...] = (
    travel.LinearTracking,
    travel.AngularTracking,
    effort.CostOfTransport,
    effort.MeanPower,
    effort.PeakTorqueShare,
    effort.TorqueRmsShare,
    effort.LimitTime,
    motion.ActionRate,
    motion.ActionAcceleration,
    motion.FootSlip,
    motion.BaseRollRms,
    motion.BasePitchRms,
    motion.ContactImpulse,
    travel.TimeToFinish,
    travel.DistanceBeforeFall,
)
BUILT_IN: dict[str, type[Score]] = {cls.spec.name: cls for cls in _CLASSES}
"""By name, in the order of docs/scores.md."""


def score_names() -> tuple[str, ...]:
    """Return the names of all scores, the built-in ones first."""
    return (*BUILT_IN, *sorted(_installed().keys() - BUILT_IN.keys()))


def score_class(name: str) -> type[Score]:
    """Return the class of a score.

    Raises:
        ValueError: there is none of that name, or its package is broken.
    """
    return BUILT_IN[name] if name in BUILT_IN else _plugin(name)


def specs_of(names: Iterable[str]) -> dict[str, ScoreSpec]:
    """Return the declarations of scores by name.

    Raises:
        ValueError: as `score_class`.
    """
    return {name: score_class(name).spec for name in names}


def plugins_among(names: Iterable[str]) -> tuple[str, ...]:
    """Return those of some names that are not built in."""
    return tuple(name for name in names if name not in BUILT_IN)


@cache
def _installed() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=SCORES), key=lambda p: (p.name, _owner(p))):
        found.setdefault(point.name, point)
    return found


def _owner(point: EntryPoint) -> str:
    return "unknown package" if point.dist is None else str(point.dist.name)


@cache
def _plugin(name: str) -> type[Score]:
    point = _installed().get(name)
    if point is None:
        raise ValueError(f"{name!r} is no score; {nearest(name, score_names())}")
    subject = f"score {name!r} of {_owner(point)}"
    try:
        cls = point.load()
    except Exception as error:
        raise ValueError(
            f"{subject} is broken: {type(error).__name__}: {error}; install it again"
        ) from error
    if not (isinstance(cls, type) and issubclass(cls, Score)):
        reason = f"{subject} is no subclass of nw_eval.scores.Score; make it one"
        raise ValueError(reason)  # noqa: TRY004  # Suites collect these.
    if getattr(cls, "spec", None) is None or cls.spec.name != name:
        raise ValueError(f"{subject} declares no `spec` of that name; give it one")
    return cls
