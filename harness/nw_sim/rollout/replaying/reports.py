"""What a replay, a takeover, a failure attribution and the repetition of trials found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from nw_sim.rollout.replaying.logged import recorded_rate

if TYPE_CHECKING:
    from nw_base.errors import NwEvalError


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Something that is not as it was recorded."""

    name: str
    recorded: str
    """What the log says; empty if it says nothing."""
    now: str


@dataclass(frozen=True, kw_only=True)
class ReplayReport:
    """A recorded trial that was run again."""

    trial: str
    start_step: int
    """The control step from which on it was run; 0 = all of it."""
    steps: int
    """How many control steps it has now."""
    end: str
    """Its outcome now, or the kind of error that ended it."""
    differences: tuple[Difference, ...]
    """Of its end: outcome, waypoints, digests of states and actions."""
    versions: tuple[Difference, ...]
    """Of the code and the libraries; under others equal bits cannot be expected."""
    picture: Path | None = None
    """The trial's contact sheet, if it was asked for."""
    video: Path | None = None
    """Its video, as above."""

    @property
    def is_identical(self) -> bool:
        """Whether the end is the recorded one, bit for bit."""
        return not self.differences


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
    control_rate: float
    """Control steps in a second, Hz."""
    position: tuple[float, float, float] | None
    """Of the trunk, world, m; None if unknown."""
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
        steps = verdict.get("steps", "")  # It may be an untrusted word.
        return cls(
            policy=policy,
            end=verdict.get("outcome") or verdict.get("error_type") or "no outcome",
            reason=verdict.get("end_reason") or verdict.get("error_text") or "",
            waypoints=f"{verdict.get('waypoints_reached')} of {verdict.get('waypoints_total')}",
            steps=int(steps) if steps.isdecimal() and len(steps) < 10 else 0,
            control_rate=recorded_rate(verdict),
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
    """As above; of all of the new trial."""

    @property
    def is_identical(self) -> bool:
        """Whether the same bits came of it."""
        return self.was.digests == self.now.digests


@dataclass(frozen=True, kw_only=True)
class Try:
    """The baseline, let loose at one moment of the recorded trial."""

    step: int
    """The first control step in which it acted."""
    end: str
    """The result: an outcome, or the kind of error that ended it."""
    reason: str
    """What decided that."""
    steps: int
    """Control steps of the trial then."""
    limits: Mapping[str, float] = field(default_factory=dict[str, float])
    """When limits were first passed in the trial then, s, by score: see `AttributionReport`."""

    @property
    def completes(self) -> bool:
        """Whether all waypoints were reached."""
        return self.end == "completed"


@dataclass(frozen=True, kw_only=True)
class AttributionReport:
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
    limits: Mapping[str, float] = field(default_factory=dict[str, float])
    """When limits were first passed in the recorded trial, s, by score: `limit_time`, and what the
    suite expects; empty where its suite measures no scores."""

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


Kind = Literal["state", "action", "observation", "image", "other"]
"""Of what a log holds."""


@dataclass(frozen=True, kw_only=True)
class RepeatedTrial:
    """A trial of the run that was run again."""

    trial: str
    steps: int
    """Control steps that it has now."""
    differences: tuple[Difference, ...]
    """Columns of its row that are others now, the digests of states and actions among them."""
    partings: Mapping[Kind, int]
    """The control step, from 0, from which on its log holds others: its images, say."""
    log: Literal["same", "compared", "gone"]
    """The log has the same bytes; or was compared message by message; or cannot be compared."""
    fault: str = ""
    """Why it has no result this time."""

    @property
    def is_identical(self) -> bool:
        """Whether all that was compared is the same, bit for bit."""
        return not (self.fault or self.differences or self.partings)


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Trials of a run that were run again."""

    seed: int
    """What drew them."""
    of: int
    """How many trials with a result they were drawn from."""
    trials: tuple[RepeatedTrial, ...] = ()
    unable: NwEvalError | None = None
    """Why none could be run again, or compared."""
    interrupted: bool = False
