"""What docs/concepts/baseline.md says of intervals from few seeds of one training recipe."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t

PAGE = Path(__file__).resolve().parents[4] / "docs" / "concepts" / "baseline.md"
Draw = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def collapsing(share: float, drop: float) -> Draw:
    def draw(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        collapsed = rng.random(shape) < share
        return np.where(collapsed, 0.93 - drop, 0.93) + rng.normal(0.0, 0.005, shape)

    return draw


SPREADS: dict[str, Draw] = {
    "normal": lambda rng, shape: rng.normal(0.93, 0.015, shape),
    "one seed of ten collapses by 0.18": collapsing(0.1, 0.18),
    "one of five collapses by 0.13": collapsing(0.2, 0.13),
    "exponential below 1": lambda rng, shape: 1.0 - rng.exponential(0.05, shape),
}


@pytest.mark.parametrize("spread", SPREADS)
def test_the_page_says_how_often_an_interval_from_few_seeds_convicts_an_equal_recipe(spread):
    line = next(x for x in PAGE.read_text().splitlines() if x.startswith(f"| {spread} |"))
    printed = [float(x) for x in re.findall(r"([\d.]+) %", line)]
    rng, repetitions = np.random.default_rng(1), 100_000
    for seeds, share in zip((3, 5, 10, 19), printed, strict=True):
        seen = SPREADS[spread](rng, (repetitions, seeds))
        candidate = SPREADS[spread](rng, (repetitions,))
        width = t.ppf(0.95, seeds - 1) * seen.std(1, ddof=1) * sqrt(1 + 1 / seeds)
        found = 100 * float((candidate < seen.mean(1) - width).mean())
        assert found == pytest.approx(share, abs=0.4)
