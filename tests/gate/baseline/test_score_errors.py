"""Gates with five scores: how often the shipped code errs where every claim is just not true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nw_gate.absolute import judge
from nw_gate.baseline.judge import compare
from nw_gate.baseline.scores import with_scores
from nw_gate.results.baseline import BaselineResults
from nw_gate.scores import specs_of
from nw_gate.settings import Gate

NAMES = ("torque_rms_share", "limit_time", "foot_slip", "base_roll_rms", "base_pitch_rms")
"""Of the range 0 to 1, so that a value is a share, and less is better."""
LEVEL, DROP, TOLERATE, BAR = 0.4, 0.25, 0.05, 0.5
SCENES, TRIALS, STARTS = "abcd", 20, 60
NOMINAL = 0.2
"""Of a wrong PASS, and of a wrong REGRESSED: large, so that some hundred gates show an excess."""


def drawn(rng: np.random.Generator, mean: float, count: int, kind: str) -> np.ndarray:
    """Draw values of a mean: all or nothing, or spread."""
    if kind == "all or nothing":
        return (rng.random(count) < mean).astype(float)
    return rng.beta(4.0 * mean, 4.0 * (1.0 - mean), count)


def panel(rng: np.random.Generator, count: int, kind: str) -> np.ndarray:
    """Draw a baseline's values, whose mean is exactly the level."""
    if kind == "all or nothing":
        return rng.permutation(np.arange(count) < round(LEVEL * count)).astype(float)
    values = drawn(rng, LEVEL, count, kind)
    values *= LEVEL / values.mean()
    over = values > 1.0
    lost = (values[over] - 1.0).sum()
    values[over] = 1.0
    values[~over] *= 1.0 + lost / values[~over].sum()
    return values


@pytest.fixture
def gates(make_run, make_baseline, drawn_rows, make_against):
    """Words of simulated gates, each with a baseline of its own, from the candidate's means."""

    def simulate(
        means: dict[str, float],
        kind: str,
        *,
        what: str,
        count: int,
        seed: int,
        moved: Mapping[str, float] | None = None,
    ) -> Any:
        asks = {"max_drop": DROP, "tolerate": TOLERATE} if what == "baseline" else {"bar": BAR}
        gate = Gate(
            scores=dict.fromkeys(NAMES, asks),
            false_alarm=NOMINAL,
            confidence=1.0 - NOMINAL,
            tiers={} if moved is None else {"a": "critical"},
        )
        by_scene = moved or {}
        run = make_run(SCENES, TRIALS, drawn_from=STARTS)
        run = run.model_copy(update={"scores": specs_of(NAMES)})
        plain = make_baseline(run, dict.fromkeys(SCENES, [1.0] * STARTS))
        rows = drawn_rows(run, dict.fromkeys(SCENES, 1.0))
        found = compare(rows, run, make_against(plain), gate)
        verdict = replace(judge(rows, gate, run.planned, against=found), against=found)
        rng = np.random.Generator(np.random.PCG64(seed))
        words = []
        for _ in range(count):
            starts = plain.panels[0].starts
            # The drop is from the baseline's own mean, so that this is to be the level exactly.
            before = np.stack([panel(rng, len(starts), kind) for _ in NAMES], axis=1)
            now = np.zeros((len(rows), len(NAMES)))
            for scene in SCENES:
                there = [number for number, row in enumerate(rows) if row.scene == scene]
                for place, name in enumerate(NAMES):
                    mean = means[name] + by_scene.get(scene, 0.0)
                    now[there, place] = drawn(rng, mean, len(there), kind)
            scored = tuple(
                replace(start, scores=tuple(zip(NAMES, each, strict=True)))
                for start, each in zip(starts, before.tolist(), strict=True)
            )
            baseline = BaselineResults(
                manifest=plain.manifest.model_copy(update={"scores": NAMES}),
                panels=(replace(plain.panels[0], starts=scored),),
            )
            ran = [
                replace(row, scores=tuple(zip(NAMES, each, strict=True)))
                for row, each in zip(rows, now.tolist(), strict=True)
            ]
            shown = with_scores(verdict, ran, run, gate, make_against(baseline))
            words.append(shown.verdict)
        return words

    return simulate


def at_most(share: float, nominal: float, count: int) -> bool:
    """Whether a share of simulated gates is no more than a nominal one, within three errors."""
    return share <= nominal + 3.0 * float(np.sqrt(nominal * (1.0 - nominal) / count))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["all or nothing", "spread"])
def test_five_scores_that_are_just_tolerated_are_regressed_at_most_as_often_as_the_gate_says(
    gates, kind
):
    count = 300
    found = gates(
        dict.fromkeys(NAMES, LEVEL + TOLERATE), kind, what="baseline", count=count, seed=1
    )
    wrong = sum(word == "REGRESSED" for word in found)
    assert at_most(wrong / count, NOMINAL, count)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["all or nothing", "spread"])
def test_one_score_of_five_that_is_worse_by_max_drop_passes_at_most_as_often_as_the_gate_says(
    gates, kind
):
    count = 300
    means = dict.fromkeys(NAMES, LEVEL - 0.2) | {NAMES[2]: LEVEL + DROP}
    found = gates(means, kind, what="baseline", count=count, seed=2)
    wrong = sum(word == "PASS" for word in found)
    assert at_most(wrong / count, NOMINAL, count)
    better = gates(dict.fromkeys(NAMES, LEVEL - 0.2), kind, what="baseline", count=50, seed=3)
    assert sum(word == "PASS" for word in better) > 40, "the others do not hold it back"


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["all or nothing", "spread"])
def test_at_their_bars_five_scores_convict_and_one_passes_at_most_as_often_as_the_gate_says(
    gates, kind
):
    count = 400
    at_the_bar = gates(dict.fromkeys(NAMES, BAR), kind, what="bar", count=count, seed=4)
    wrong = sum(word == "REGRESSED" for word in at_the_bar)
    assert at_most(wrong / count, NOMINAL, count)
    means = dict.fromkeys(NAMES, 0.2) | {NAMES[0]: BAR}
    one = gates(means, kind, what="bar", count=count, seed=5)
    assert at_most(sum(word == "PASS" for word in one) / count, NOMINAL, count)
    worse = gates(dict.fromkeys(NAMES, 0.8), kind, what="bar", count=50, seed=6)
    assert sum(word == "REGRESSED" for word in worse) == 50


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["all or nothing", "spread"])
def test_a_critical_scene_that_is_worse_by_max_drop_in_five_scores_convicts_at_most_by_its_share(
    gates, kind
):
    count = 300
    rest = (len(SCENES) * TOLERATE - DROP) / (len(SCENES) - 1)  # The mean is just tolerated.
    moved = dict.fromkeys(SCENES, rest) | {"a": DROP}
    level = dict.fromkeys(NAMES, LEVEL)
    found = gates(level, kind, what="baseline", count=count, seed=7, moved=moved)
    wrong = sum(word == "REGRESSED" for word in found)
    assert at_most(wrong / count, NOMINAL * (1.0 + 1.0 / len(SCENES)), count)
    far = dict.fromkeys(SCENES, -0.15) | {"a": 0.55}
    worse = gates(level, kind, what="baseline", count=50, seed=8, moved=far)
    assert sum(word == "REGRESSED" for word in worse) > 40, "what fell there by far is seen"


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["all or nothing", "spread"])
def test_a_critical_scene_at_the_bars_of_five_scores_convicts_at_most_by_its_share(gates, kind):
    count = 400
    moved = dict.fromkeys(SCENES, -0.3) | {"a": 0.0}
    at_the_bar = dict.fromkeys(NAMES, BAR)
    found = gates(at_the_bar, kind, what="bar", count=count, seed=9, moved=moved)
    wrong = sum(word == "REGRESSED" for word in found)
    assert at_most(wrong / count, NOMINAL, count)
    far = dict.fromkeys(SCENES, -0.4) | {"a": 0.4}
    worse = gates(at_the_bar, kind, what="bar", count=50, seed=10, moved=far)
    assert sum(word == "REGRESSED" for word in worse) > 40, "what is beyond it by far is seen"
