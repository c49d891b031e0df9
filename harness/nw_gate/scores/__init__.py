"""Scores: declared numbers of a trial, by name: those built in, and those of installed packages.

What is not built in is looked for among the entry points of `nw_eval.scores`, each a subclass of
`Score` whose `spec` has the name of the entry point. Nothing of a package is imported before a
suite names it. Built-in names always win.
"""

from __future__ import annotations

from collections.abc import Iterable

from nw_base.errors import UsageError, nearest
from nw_base.plugins import SCORES, installed, load_class
from nw_gate.scores.effort import (
    CostOfTransport,
    LimitTime,
    MeanPower,
    PeakTorqueShare,
    TorqueRmsShare,
)
from nw_gate.scores.motion import (
    ActionAcceleration,
    ActionRate,
    AngularTracking,
    BasePitchRms,
    BaseRollRms,
    ContactImpulse,
    DistanceBeforeFall,
    FootSlip,
    LinearTracking,
    TimeToFinish,
)
from nw_gate.scores.own import class_of
from nw_gate.scores.score import Figures, MissingReadingError, Score, ScoreSpec, Stretch, TrialEnd

__all__ = [
    "Figures",
    "MissingReadingError",
    "Score",
    "ScoreSpec",
    "Stretch",
    "TrialEnd",
    "score_class",
    "score_names",
    "specs_of",
]


_CLASSES: tuple[type[Score], ...] = (
    LinearTracking,
    AngularTracking,
    CostOfTransport,
    MeanPower,
    PeakTorqueShare,
    TorqueRmsShare,
    LimitTime,
    ActionRate,
    ActionAcceleration,
    FootSlip,
    BaseRollRms,
    BasePitchRms,
    ContactImpulse,
    TimeToFinish,
    DistanceBeforeFall,
)
BUILT_IN: dict[str, type[Score]] = {cls.spec.name: cls for cls in _CLASSES}
"""By name, in the order of docs/reference/scores.md."""


def score_names() -> tuple[str, ...]:
    """Return the names of all scores, the built-in ones first."""
    return (*BUILT_IN, *sorted(installed(SCORES).keys() - BUILT_IN.keys()))


def score_class(name: str, *, allow_code: bool = False) -> type[Score]:
    """Return the class of a score; the package of one that is not built in is imported.

    Args:
        name: of the score, or the text of one that a suite makes up: see `scores.own`.
        allow_code: whether the code of such a text may run.

    Raises:
        UsageError: there is none of that name.
        CodeError: it is Python code of a suite, which may not run.
        PluginError: its package is broken.
    """
    if "=" in name:
        return class_of(name, score_class, allow_code=allow_code)
    if name in BUILT_IN:
        return BUILT_IN[name]
    if name not in installed(SCORES):
        raise UsageError(f"{name!r} is not a score", fix=nearest(name, score_names()))
    return load_class(SCORES, name, Score, _own_name)


def specs_of(names: Iterable[str]) -> dict[str, ScoreSpec]:
    """Return the declarations of scores by name.

    Raises:
        UsageError, PluginError: as `score_class`.
    """
    return {name: score_class(name).spec for name in names}


def _own_name(cls: type[Score]) -> str | None:
    spec = getattr(cls, "spec", None)
    return spec.name if isinstance(spec, ScoreSpec) else None
