"""How often the intervals hold what they are of, in simulated campaigns.

`python tests/gate/stats/agreement/test_coverage.py` writes coverage.json again.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nw_gate.stats.agreement import FIGURES, jackknife

SUMMARY = Path(__file__).with_name("coverage.json")
CAMPAIGNS = 2000
SETTINGS = [(n, gap) for n in (5, 6, 8, 10, 20) for gap in (0.0, 0.15, 0.4)]
"""Policies, and by how much the simulator is wrong about a policy (standard deviation)."""


def draw(rng, sets, n, gap):
    """Success of sets of policies whose true one is .1 to .95: 10 real trials, 160 simulated."""
    rates = rng.uniform(0.1, 0.95, (sets, n))
    wrong = np.clip(rates + gap * rng.standard_normal((sets, n)), 0.0, 1.0)
    return rng.binomial(10, rates) / 10, rng.binomial(160, wrong) / 160


def coverage(n, gap):
    """Per figure, in %, how often its 95 % interval holds its mean over sets of n policies."""
    rng = np.random.default_rng([n, round(100 * gap)])
    many, campaigns = draw(rng, 20_000, n, gap), draw(rng, CAMPAIGNS, n, gap)
    found = {}
    for name, figure in FIGURES.items():
        target = np.nanmean(figure(*many))
        intervals = [jackknife(name, *pair, 0.95) for pair in zip(*campaigns, strict=True)]
        held = [low <= target <= high for low, high in filter(None, intervals)]
        found[name] = round(100 * float(np.mean(held)), 1)
    return found


def test_the_summary_speaks_of_every_setting_and_nine_in_ten_intervals_hold():
    summary = json.loads(SUMMARY.read_text("utf-8"))
    assert [(each["policies"], each["gap"]) for each in summary] == SETTINGS
    assert min(each[name] for each in summary for name in FIGURES) >= 90.0


@pytest.mark.nightly
@pytest.mark.parametrize("index", range(len(SETTINGS)))
def test_coverage_is_what_the_summary_says(index):
    n, gap = SETTINGS[index]
    expected = json.loads(SUMMARY.read_text("utf-8"))[index]
    for name, percent in coverage(n, gap).items():
        assert percent == pytest.approx(expected[name], abs=1.0)  # Other versions of numpy.


if __name__ == "__main__":
    lines = [json.dumps({"policies": n, "gap": gap, **coverage(n, gap)}) for n, gap in SETTINGS]
    SUMMARY.write_text("[\n  " + ",\n  ".join(lines) + "\n]\n", encoding="utf-8")
