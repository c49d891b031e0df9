"""What the gate says: one frozen object that every report renders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal
from warnings import warn

from nw_eval.gate.baseline.comparison import Comparison
from nw_eval.stats import Interval
from nw_eval.words import Tier

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
    weak: bool = False  # Its whole interval lies below the bar.
    condemned: bool = False  # Critical, and below the bar beyond doubt: it convicts alone.
    outside: int = 0  # Trials that left the captured volume, and are in nothing above.
    split: Literal["train", "eval"] | None = None  # Whether the policy was trained in it.
    unseen: bool = False  # So many that this scene says too little (`gate.validity.at_most`).

    @property
    def missing(self) -> int:
        """Trials that were planned and have no row."""
        return max(0, self.planned - self.n - self.errors - self.outside)


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
    def exit_code(self) -> int:
        """What the process should exit with."""
        return EXIT_CODES[self.verdict]
