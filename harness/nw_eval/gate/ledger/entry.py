"""What a ledger keeps of one verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime
from hashlib import sha256
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from nw_eval.gate.baseline.comparison import Basis
from nw_eval.gate.outlook import courses
from nw_eval.gate.scores import by_scene
from nw_eval.gate.verdict import Verdict, Word
from nw_eval.results.bank import trajectory
from nw_eval.results.provenance import BaselineInfo, RunInfo
from nw_eval.results.row import Row
from nw_eval.stats import SceneCounts
from nw_eval.words import PanelKind, Tier

_MOST_TRAJECTORIES = 64
"""Trials of a verdict by which its candidate can be told from others."""


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class SeenScene(_Line):
    """One scene that counts: trials that ended with 0, 1, ..., k waypoints reached."""

    counts: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = Field(
        min_length=2, max_length=10_000
    )
    alone: bool = False

    @model_validator(mode="after")
    def _with_trials(self) -> Self:
        if not any(self.counts):
            raise ValueError("a scene without trials")
        return self


class BaselineEntry(_Line):
    """The comparison that a verdict rests on."""

    bank: str
    digest: str
    """Of the bank's file."""
    basis: Basis | Literal["sample"]
    """"sample" is of an older nw-eval, which ran no control."""
    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    trials: int = Field(default=0, ge=0)
    """0: an older nw-eval, which counted rounds."""
    drop: float | None
    max_drop: float
    tolerate: float
    alpha_pass: float = Field(gt=0.0, lt=1.0)
    alpha_regr: float = Field(gt=0.0, lt=1.0)
    scene_drop: float | None = None
    """None: an older nw-eval, which did not write it."""
    scenes: int = Field(default=0, ge=0)
    """Scenes that count, each as often as it has cells of perturbations; 0: likewise."""
    critical: int = Field(default=0, ge=0)
    """Of these, such as convict alone."""


class LedgerEntry(_Line):
    """One verdict: who was judged, on which starts, against what, and how."""

    time: AwareDatetime
    """When it was given."""
    run: str
    """The run's name."""
    suite: str
    suite_digest: str
    """With the seed in it: it names the panel."""
    panel: PanelKind
    candidate: str
    """The policy's name."""
    candidate_digest: str
    """Of the files: checkpoint and card."""
    computes: str = ""
    """What the candidate computes (`PolicyInfo.computes`); empty where that is unknown."""
    word: Word
    trials: int = Field(ge=0)
    success: float | None
    """Mean success, scenes weighted equally."""
    bar: float | None
    confidence: float = Field(gt=0.0, lt=1.0)
    """Of each of the bar's bounds."""
    seen: tuple[SeenScene, ...] = ()
    tiers: dict[str, Tier] = Field(default_factory=dict[str, Tier])
    """Of all scenes that were judged, by name; empty: an older nw-eval, which did not write it."""
    trajectories: dict[str, str] = Field(default_factory=dict[str, str], max_length=10_000)
    """Some of the trials: `results.bank.trajectory` by a digest of the start."""
    baseline: BaselineEntry | None = None

    @property
    def is_test(self) -> bool:
        """Whether chance could have given another word: not without trials, nor by a hole."""
        is_same = self.baseline is not None and self.baseline.basis == "same"
        return self.word in {"PASS", "REGRESSED", "INCONCLUSIVE"} and not is_same

    @property
    def scenes(self) -> list[SceneCounts]:
        """What was seen, for `stats`."""
        return [
            SceneCounts(counts=np.array(scene.counts, dtype=np.int64), alone=scene.alone)
            for scene in self.seen
        ]

    @property
    def test(self) -> tuple[object, ...]:
        """What is equal for two verdicts on one candidate by one test: same trials, same rules.

        More trials of a run are no other test, since the bounds hold at any look. Other scenes,
        tiers or margins are: whoever picks them after a look has had one more chance. So are the
        starts of a baseline, or fresh ones, in another order.
        """
        rules = self.baseline and self.baseline.model_dump(
            include={"digest", "max_drop", "tolerate", "scene_drop", "alpha_pass", "alpha_regr"}
        )
        is_drawn = self.baseline is not None or self.panel == "fresh"
        drawn_by = (self.computes or self.candidate_digest) if is_drawn else ""
        scenes = tuple(sorted(self.tiers.items()))
        panel = (drawn_by, self.suite_digest, self.panel, scenes)
        return (*panel, self.bar, self.confidence, *(rules.values() if rules else ()))


def entry_of(
    verdict: Verdict,
    run: RunInfo,
    rows: Sequence[Row],
    *,
    time: datetime,
    bank: BaselineInfo | None = None,
) -> LedgerEntry:
    """Return what a ledger keeps of a verdict.

    Args:
        verdict: that was given.
        run: what it is on.
        rows: that it rests on.
        time: when it was given, with its time zone.
        bank: that the run was compared with; the one that it was begun against if None.
    """
    who = f"{run.policy.checkpoint_digest}/{run.policy.card_digest}"
    seen = courses(by_scene(rows, run.planned), verdict.per_scene, verdict.left)
    return LedgerEntry(
        time=time,
        run=run.id,
        suite=str(run.suite.get("name", "")),
        suite_digest=run.suite_digest,
        panel=run.panel,
        candidate=run.policy.name,
        candidate_digest=sha256(who.encode()).hexdigest(),
        computes=run.policy.computes,
        word=verdict.verdict,
        trials=verdict.n,
        success=verdict.success,
        bar=verdict.bar,
        confidence=verdict.confidence,
        seen=tuple(
            SeenScene(counts=tuple(scene.counts.tolist()), alone=scene.alone) for scene in seen
        ),
        tiers={item.scene: item.tier for item in verdict.per_scene},
        trajectories=_trajectories(rows, run.suite_digest),
        baseline=_baseline(verdict, bank or run.baseline),
    )


def _trajectories(rows: Sequence[Row], suite_digest: str) -> dict[str, str]:
    """Return trajectories by digests of starts, of the trials whose starts have the smallest ones.

    Two candidates that met the same starts keep the same ones of them. A trial that a policy failed
    in tells nothing: many do so at once, in the same way.
    """
    found: dict[str, str] = {}
    for row in rows:
        if row.status == "ok" and row.outcome != "policy_failed" and row.state_digest:
            facts = [suite_digest, row.scene, row.scene_digest, row.perturbation, row.seed_index]
            start = sha256(json.dumps([*facts, row.seed]).encode()).hexdigest()[:16]
            found[start] = trajectory(row)
    return dict(sorted(found.items())[:_MOST_TRAJECTORIES])


def _baseline(verdict: Verdict, bank: BaselineInfo | None) -> BaselineEntry | None:
    found = verdict.against
    if found is None:
        return None
    return BaselineEntry(
        bank=found.bank,
        digest="" if bank is None else bank.sha256,
        basis=found.basis,
        word=found.word,
        trials=found.trials,
        drop=found.drop,
        max_drop=found.max_drop,
        tolerate=found.tolerate,
        alpha_pass=found.alpha_pass,
        alpha_regr=found.alpha_regr,
        scene_drop=found.scene_drop,
        scenes=sum(scene.counts for scene in found.scenes),
        critical=sum(scene.tier == "critical" for scene in found.scenes),
    )
