"""What the gate says, alone and against a baseline: frozen objects that every report renders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple
from warnings import warn

from nw_base.plural import plural
from nw_base.words import Tier
from nw_gate.results.baseline import Stratum
from nw_gate.results.column import Settings
from nw_gate.scores import ScoreSpec
from nw_gate.stats.baseline.curve import CurvePoint
from nw_gate.stats.hazard import Ends
from nw_gate.stats.interval import Interval

if TYPE_CHECKING:
    from nw_gate.limits.limit import Limit

Word = Literal["PASS", "RAN", "REGRESSED", "INCONCLUSIVE", "INFRASTRUCTURE", "INVALID"]

EXIT_CODES: Mapping[Word, int] = {
    "PASS": 0,
    "RAN": 0,  # All trials ran, and the suite has no bar to judge them by.
    "REGRESSED": 1,
    "INCONCLUSIVE": 3,  # 2 is usage, as everywhere.
    "INFRASTRUCTURE": 4,
    "INVALID": 5,
}


@dataclass(frozen=True, kw_only=True)
class SceneScore:
    """How a policy did in one scene."""

    scene: str
    tier: Tier
    planned: int
    n: int  # Trials with a result.
    errors: int
    completed: int
    mean: float | None  # Mean success; None without results.
    interval: Interval  # Of mean success: stratified bootstrap.
    weak: bool = False
    """Its whole interval lies below the bar. The interval is of this scene alone: with many scenes
    at the bar some are weak by chance, and no verdict rests on it."""
    flagged: bool = False  # Critical, and significantly below the bar: REGRESSED by itself.
    outside: int = 0  # Trials that left the captured volume, and are in nothing above.
    split: Literal["train", "eval"] | None = None  # Whether the policy was trained in it.
    unseen: bool = False  # So many that this scene says too little (`gate.validity.at_most`).

    @property
    def missing(self) -> int:
        """Trials that were planned and have no row."""
        return max(0, self.planned - self.n - self.errors - self.outside)


@dataclass(frozen=True, kw_only=True)
class ScoreFinding:
    """What a run shows of one score beside success, in the score's unit."""

    spec: ScoreSpec
    """Its declaration, with the range that counts here."""
    trials: int
    """Those that count, each with a result."""
    undefined: int
    """Of these, such as have no value, and count as the declaration says."""
    kept: int
    """Of these, such as are at the best end of the range: trials that kept an expectation."""
    mean: float | None
    """Scenes weighted equally; None without trials."""
    interval: Interval
    """Two one-sided bounds of the mean, as `Verdict.interval`."""
    per_scene: Mapping[str, float]
    """Mean by scene."""
    bar: float | None = None
    max_drop: float | None = None
    baseline: float | None = None
    """The baseline's mean, where one was compared with."""
    drop: float | None = None
    """Change for the worse against it; None where none was tested."""
    drops: Interval | None = None
    """Changes for the worse that are not ruled out."""
    word: Word | None = None
    """What the gate makes of it; None where it does not judge it."""
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class LimitFinding:
    """What a run shows of the policy's limit on one ladder."""

    ladder: str
    """The ladder's name, such as `hurdles/bar`."""
    title: str
    """What its rungs are, for people."""
    word: Word | None
    """What the gate makes of it; None where it does not judge it."""
    sentence: str
    """Why."""
    candidate: Limit | None = None
    """The policy's limit; None where nothing ran."""
    baseline: Limit | None = None
    """That of the baseline's policy; None where the two are not compared."""
    at_least: float | None = None
    max_drop: float | None = None


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on one run.

    `interval` holds two one-sided bounds, each of `confidence`: the lower one passes a run, the
    upper one fails it, so each kind of wrong decision has at most probability 1 - confidence; a
    wrong REGRESSED has twice that where critical scenes are judged alone too.
    """

    verdict: Word
    success: float | None  # Mean success, scenes weighted equally; None without results.
    interval: Interval
    confidence: float
    bar: float | None
    n: int
    planned: int
    errors: int
    reasons: tuple[str, ...]
    per_scene: tuple[SceneScore, ...]
    against: Comparison | None = None  # What it also rests on; None without a baseline.
    left: frozenset[str] = frozenset()  # Trials that left the captured volume, by their names.
    scores: tuple[ScoreFinding, ...] = ()  # What was measured beside success.
    limits: tuple[LimitFinding, ...] = ()  # Of the ladders that the gate names.
    failures: str = ""  # How most of the trials failed that count, in words; empty if none did.

    @property
    def effect(self) -> float | None:
        """`success` under its name until 0.1; deprecated."""
        warn("Verdict.effect is now Verdict.success", DeprecationWarning, stacklevel=2)
        return self.success

    @property
    def completed(self) -> int:
        """Trials, of the `n` that count, that reached their last waypoint."""
        return sum(item.completed for item in self.per_scene if item.tier != "informational")

    @property
    def whole(self) -> bool:
        """Whether every trial that was planned has a result."""
        return 0 < self.planned == sum(item.n for item in self.per_scene)

    @property
    def regressed_by(self) -> tuple[str, ...]:
        """What made it REGRESSED, in words: the bar, the baseline, a scene, a score."""
        if self.verdict != "REGRESSED":
            return ()
        comparison, by = self.against, list[str]()
        if self.bar is not None and self.interval.high < self.bar:
            by.append("the bar")
        scenes = [item.scene for item in self.per_scene if item.flagged]
        if comparison is not None and comparison.word == "REGRESSED":
            if comparison.mean_regressed:
                by.append("the baseline comparison")
            critical = (
                item for item in comparison.scenes if item.named and item.tier == "critical"
            )
            scenes += [item.name for item in critical]
        by += [f"critical scene {name}" for name in dict.fromkeys(scenes)]
        return (
            *by,
            *(f"score {item.spec.name}" for item in self.scores if item.word == self.verdict),
            *(f"the limit of {item.ladder}" for item in self.limits if item.word == self.verdict),
        )

    @property
    def exit_code(self) -> int:
        """What the process should exit with."""
        return EXIT_CODES[self.verdict]


Basis = Literal["same", "panel", "control", "fresh"]
"""What the baseline is to the candidate's trials. same: the policy is the baseline by its digests,
and has the baseline's bits here as far as was seen.
panel: the baseline's result from every start is known exactly on this class of machine. control:
bits are others here, and the baseline's policy ran beside the candidate, from the same starts.
fresh: the candidate met other starts."""

Claim = Literal["fresh", "panel"]
"""Of which starts a comparison speaks: of fresh ones in the same scenes, or of those of the
baseline's seed set alone (`gate.claim: panel`)."""


@dataclass(frozen=True, kw_only=True)
class Recheck:
    """Trials of the baseline's own policy in this run, beside what the baseline says of them."""

    compared: int
    """Trials with a result."""
    ran: int
    """Of these, such as ran in this run; the others were reused from the cache of trials."""
    equal: bool
    """Whether all of them have the baseline's values and bits."""
    differing: tuple[str, ...]
    """Sentences, where the baseline is not what its policy does: which trials differ and in what.
    On a class of machine that the baseline has not seen bits may be others, and only a trial with
    the same bits and another result is named. Where there are any the run is INVALID."""
    taken_over: bool
    """Whether the other results are the baseline's: all trials that were to run again did, at
    least one of each scene, and are equal."""

    @property
    def in_words(self) -> str:
        """How many trials ran again, and its result."""
        if not self.compared:
            return "no trial re-run"
        if not self.equal:
            return (
                f"this machine computes slightly different results from the one that saved the "
                f"baseline, so no result is reused ({plural(self.ran, 'trial')} re-run)"
            )
        reused = self.compared - self.ran
        cached = f", {reused} reused from the cache and identical" if reused else ""
        rest = "; the other results come from the baseline" if self.taken_over else ""
        return f"{plural(self.ran, 'trial')} re-run and identical{cached}{rest}"


@dataclass(frozen=True, kw_only=True)
class SceneDrop:
    """How the candidate did in one scene (and cell of perturbations) against the baseline."""

    scene: str
    perturbation: Settings = ()
    tier: Tier
    baseline: float | None
    """B_s, mean success over all starts of the baseline. Beside a control it is that of the
    control's
    trials which were judged: None without any, since the baseline's scores are not compared
        with."""
    candidate: float | None
    """Mean success over the trials judged; None without any."""
    trials: int
    evidence: float
    """E_s; 1 for an informational scene, which is not judged."""
    named: bool
    """Whether it regressed significantly."""
    interval: Interval | None = None
    """Drops in this scene that its own trials do not rule out, at the errors of the verdict; of
    many scenes some miss. None where it is not judged, or before a report is asked for."""
    waypoint: int | None = None
    """The first waypoint, from 1, at which the two part significantly: of a scene that regressed or
    may have, or has the largest drop of a policy that regressed."""
    ends: tuple[Ends, Ends] | None = None
    """Of all starts of the baseline, and of the trials judged that have a result: how many ended
    after 0, 1, .. K waypoints. None where the scene has no waypoints."""

    @property
    def stratum(self) -> Stratum:
        """The scene and what was changed there."""
        return (self.scene, self.perturbation)

    @property
    def counts(self) -> bool:
        """Whether it counts for the verdict."""
        return self.tier != "informational"

    @property
    def drop(self) -> float | None:
        """How much less the candidate scored; None without a trial."""
        if self.candidate is None or self.baseline is None:
            return None
        return self.baseline - self.candidate

    @property
    def name(self) -> str:
        """The scene, with what was changed there."""
        return " ".join([self.scene, *(f"{axis} {value:g}" for axis, value in self.perturbation)])


class Paired(NamedTuple):
    """How many trials from the same initial states completed."""

    candidate: int
    baseline: int
    trials: int


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What the trials so far show of the candidate's drop against a baseline.

    Drops are the baseline's mean success less the candidate's, scenes weighted equally.
    """

    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    baseline_name: str
    """The baseline's name."""
    policy: str
    """The baseline's policy."""
    basis: Basis
    claim: Claim
    trials: int
    """Trials that were judged, of scenes that count: up to the one that settled it."""
    budget: int
    """Most that were to be run."""
    starts: int
    """M."""
    paired: Paired | None = None
    """Trials completed from the same initial states; None where the two have none in common."""
    baseline_met: float | None = None
    """The baseline's mean in the scenes of the trials that `drop` is of: the candidate's mean over
    these trials and the drop. None without a trial."""
    baseline: float
    """B, of the scenes that count. Beside a control it is that of the pairs of trials that bear on
    the drop, and the baseline's while there are none."""
    drop: float | None
    """Estimate of the drop; None without a trial."""
    interval: Interval | None
    """Drops not excluded: its low end errs with alpha_regr, its high end with alpha_pass. None
    where nothing was tested, or before a report is asked for."""
    mean_regressed: bool
    """Whether the mean itself has regressed significantly."""
    false_alarm: float
    """Probability, at most, that this gate is REGRESSED by a policy that is good enough: of its
    bar, the baseline, and critical scenes of both together."""
    max_drop: float
    tolerate: float
    scene_drop: float
    alpha_pass: float
    alpha_regr: float
    scenes: tuple[SceneDrop, ...]
    reasons: tuple[str, ...]
    more: str | None = None
    """About how many more trials would settle it, where that was simulated."""
    left_aside: int = 0
    """Scenes of the baseline that the run was not asked for."""
    control: int = 0
    """Trials of the baseline's own policy that ran beside the candidate."""
    control_drop: tuple[float, Interval] | None = None
    """How much less the control scores than the baseline says, and the values that are not
    excluded, at the errors of `interval`; None without a control, or before a report is asked
    for."""
    again: Recheck | None = None
    """What ran of the baseline's own policy, where the candidate is that policy on its starts."""
    is_own: bool = False
    """Whether the candidate is the baseline's own policy, with other bits than the baseline's: what
    is compared is this machine or version."""
    curve: tuple[tuple[CurvePoint, ...], tuple[CurvePoint, ...], tuple[CurvePoint, ...]] | None = (
        None
    )
    """How this gate ends for an equal policy, and for ones worse by half of max_drop and by it:
    a point for each kind of policy; simulated, where that was asked for."""

    @property
    def settled(self) -> bool:
        """Whether further trials would change nothing."""
        return self.word != "INCONCLUSIVE"

    @property
    def known_low(self) -> float | None:
        """The low end of `interval`; None where it is the end of the range, and says nothing."""
        if self.interval is None:
            return None
        least = -1.0 if self.basis == "control" else self.baseline - 1.0
        return self.interval.low if self.interval.low > least + _NEXT_TO else None

    @property
    def known_high(self) -> float | None:
        """The high end of `interval`; None where it is the end of the range, and says nothing."""
        if self.interval is None:
            return None
        most = 1.0 if self.basis == "control" else self.baseline
        return self.interval.high if self.interval.high < most - _NEXT_TO else None


_NEXT_TO = 5e-4
"""What is printed with three digits as the end of a range is that end."""


def percent_sure(alpha: float) -> str:
    """Return how sure one is of what errs with probability `alpha`, in words."""
    return f"{100 * (1 - alpha):.4g} %"
