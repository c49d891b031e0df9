"""An axis of a sweep as it is written: `friction=0.3..1.2`, `payload=0..6:4`, `push=0,0.5,1`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pydantic import ValidationError

from nw_eval.errors import UsageError, nearest
from nw_eval.plural import plural
from nw_eval.suite.perturb import CONTROL_STEP, NEUTRAL, Perturb

STEPS = 7
"""Values from one end to the other, both counted, where nothing else is said."""
MOST_STEPS = 100
_DIGITS = 4
_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:e-?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?::(\d{{1,6}}))?")
_LIST = re.compile(rf"{_NUMBER}(?:,{_NUMBER})*")


@dataclass(frozen=True, kw_only=True)
class SweptAxis:
    """An axis and its values, ascending."""

    name: str
    values: tuple[float, ...]

    @classmethod
    def of(cls, words: str) -> SweptAxis:
        """Return the axis that words such as `friction=0.3..1.2:7` name.

        Latencies are taken to the nearest control step.

        Raises:
            UsageError: there is no such axis, or its values cannot be used.
        """
        name, equals, span = words.partition("=")
        if name not in NEUTRAL:
            fix = nearest(name, list(NEUTRAL))
            raise UsageError(f"--axis {words!r}: there is no axis {name!r}", fix=fix)
        found = _RANGE.fullmatch(span)
        if found is not None:
            values = _between(float(found[1]), float(found[2]), int(found[3] or STEPS), words)
        elif equals and _LIST.fullmatch(span):
            values = [float(value) for value in span.split(",")]
        else:
            raise UsageError(
                f"--axis {words!r}: {span!r} is no range of values",
                fix=f"write {name}=FROM..TO, {name}=FROM..TO:STEPS or {name}=VALUE,VALUE",
            )
        if name == "latency":
            values = [
                round(round(value / CONTROL_STEP) * CONTROL_STEP, _DIGITS) for value in values
            ]
        kept = tuple(sorted(set(values)))
        if len(kept) < 2:
            raise UsageError(f"--axis {words!r} has one value", fix="give two or more")
        try:
            Perturb.model_validate({name: kept})
        except ValidationError as error:
            first = error.errors()[0]
            value = first.get("input")
            raise UsageError(
                f"--axis {words!r}: {value!r}: {first['msg'].lower()}",
                fix="see the axes in docs/suites.md",
            ) from None
        return cls(name=name, values=kept)


def _between(low: float, high: float, steps: int, words: str) -> list[float]:
    if not 2 <= steps <= MOST_STEPS:
        raise UsageError(
            f"--axis {words!r} has {plural(steps, 'step')}", fix=f"give 2 to {MOST_STEPS}"
        )
    gap = (high - low) / (steps - 1)
    return [round(low + gap * step, _DIGITS) for step in range(steps)]
