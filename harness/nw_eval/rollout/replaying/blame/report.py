"""From when on a trial was lost, as plain values: they travel from a confined process."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.rollout.replaying.takeover.report import Ending


@dataclass(frozen=True, kw_only=True)
class Try:
    """The baseline, let loose at one moment of the recorded trial."""

    step: int
    """The first control step in which it acted."""
    end: str
    """What came of it: an outcome, or the kind of error that ended it."""
    reason: str
    """What decided that."""
    steps: int
    """Control steps of the trial then."""

    @property
    def completes(self) -> bool:
        """Whether all waypoints were reached."""
        return self.end == "completed"


@dataclass(frozen=True, kw_only=True)
class BlameReport:
    """A recorded trial that failed, and what a baseline makes of its moments."""

    trial: str
    was: Ending
    """As recorded."""
    baseline: str
    """Who was let loose."""
    tries: tuple[Try, ...]
    """In the order of their moments; the first is the trial's beginning."""
    stride: int
    """Control steps between two moments that could be tried."""

    @property
    def committed(self) -> Try | None:
        """The latest one that completes: from then on the trial was lost; None = none does."""
        return next((each for each in reversed(self.tries) if each.completes), None)

    @property
    def completes_throughout(self) -> bool:
        """Whether none fails: as far as was tried, the baseline saves it until the end."""
        return all(each.completes for each in self.tries)

    @property
    def is_monotone(self) -> bool:
        """Whether no try that fails lies before one that completes."""
        words = [each.completes for each in self.tries]
        return words == sorted(words, reverse=True)
