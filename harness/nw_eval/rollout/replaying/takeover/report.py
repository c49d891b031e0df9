"""What a take-over came to, as plain values: they travel from a confined process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How a trial ended."""

    policy: str
    """Who drove then."""
    end: str
    """Its outcome, or the kind of error that ended it."""
    reason: str
    """What decided the outcome, or what the error says."""
    waypoints: str
    """Reached of all, such as `2 of 4`."""
    steps: int
    """Control steps."""
    position: tuple[float, float, float] | None
    """Of the trunk, world, m; None where nobody says."""
    digests: tuple[str, str]
    """Of states and actions, hex."""

    @classmethod
    def of(
        cls,
        verdict: Mapping[str, str],
        *,
        policy: str,
        position: tuple[float, float, float] | None,
    ) -> Self:
        """Return the ending that a verdict tells, as logs have it."""
        steps = verdict.get("steps", "")  # It may be a stranger's word.
        return cls(
            policy=policy,
            end=verdict.get("outcome") or verdict.get("error_type") or "no outcome",
            reason=verdict.get("end_reason") or verdict.get("error_text") or "",
            waypoints=f"{verdict.get('waypoints_reached')} of {verdict.get('waypoints_total')}",
            steps=int(steps) if steps.isdecimal() and len(steps) < 10 else 0,
            position=position,
            digests=(verdict.get("state_digest", ""), verdict.get("action_digest", "")),
        )


@dataclass(frozen=True, kw_only=True)
class TakeoverReport:
    """A recorded trial that another policy took over."""

    trial: str
    step: int
    """The first control step in which it acted."""
    was: Ending
    """As recorded."""
    now: Ending
    video: Path | None = None
    """The new trial's, if it was asked for."""
    log: Path | None = None
    """Likewise; of all of the new trial."""

    @property
    def is_identical(self) -> bool:
        """Whether the same bits came of it."""
        return self.was.digests == self.now.digests
