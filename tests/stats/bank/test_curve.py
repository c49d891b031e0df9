"""What the hurdles suite convicts and passes at true drops, against the published curve."""

from __future__ import annotations

import numpy as np
import pytest

from nw_eval.stats import SceneCounts
from nw_eval.stats.bank import Bank, Margins, Values, decide, over_rounds
from nw_eval.stats.courses import chances_at

# Ten measured trials in each of 16 scenes: how many ended after 0, 1, ... waypoints; in all .938.
HURDLES = [
    [1, 1, 6, 0, 2],
    [0, 1, 1, 8],
    [0, 1, 0, 9],
    [0, 1, 0, 9],
    [0, 0, 2, 8],
    [0, 1, 9],
    [0, 0, 1, 0, 9],
    [0, 0, 0, 2, 8],
    [0, 0, 1, 9],
    [0, 0, 1, 9],
    [0, 0, 10],
    [0, 0, 0, 10],
    *([[0, 0, 0, 0, 10]] * 4),
]
COURSES = [SceneCounts(counts=np.array(counts, dtype=np.int64)) for counts in HURDLES]
MEAN = float(np.mean([course.counts @ course.values / course.trials for course in COURSES]))
STARTS, ROUNDS, CAMPAIGNS = 60, 20, 1000


def draw(mean: float, rng: np.random.Generator) -> np.ndarray:
    """Scores of policies whose true success is `mean`, (campaigns, starts, scenes).

    By `courses`: a chance for each scene to reach the next waypoint; a worse policy has the odds
    of all scenes multiplied by one factor. Nothing ties trials of one start together.
    """
    scenes = []
    for course, chance in zip(COURSES, chances_at(COURSES, mean), strict=True):
        waypoints = len(course.counts) - 1
        reached = rng.random((CAMPAIGNS, STARTS, waypoints)) < chance
        scenes.append(reached.cumprod(axis=-1).sum(axis=-1) / waypoints)
    return np.stack(scenes, axis=-1)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("tolerate", "drop", "regressed", "passed", "trials"),
    [
        (0.0, 0.0, 1, 99, 58),
        (0.0, 0.02, 11, 89, 76),
        (0.0, 0.05, 57, 43, 93),
        (0.0, 0.10, 96, 4, 63),
        (0.0, 0.20, 100, 0, 32),
        (0.02, 0.0, 0, 100, 58),
        (0.02, 0.02, 2, 98, 84),
        (0.02, 0.05, 36, 64, 134),
        (0.02, 0.10, 95, 5, 91),
        (0.02, 0.20, 100, 0, 37),
    ],
)
def test_the_operating_curve_is_near_the_published_one(
    tolerate: float, drop: float, regressed: float, passed: float, trials: float
) -> None:
    rng = np.random.default_rng([20263, round(1000 * drop)])
    bank, candidate = draw(MEAN, rng), draw(MEAN - drop, rng)
    rounds = over_rounds(
        Bank(means=bank.mean(axis=1), starts=STARTS),
        candidate[:, :ROUNDS],
        bank[:, :ROUNDS],
        Margins(max_drop=0.10, tolerate=tolerate),
    )
    rulings = [
        decide(
            [Values(v.passed[n], v.regressed[n], v.scenes[n]) for v in rounds],
            ["supporting"] * len(COURSES),
            alpha_pass=0.05,
            alpha_regr=0.05,
        )
        for n in range(CAMPAIGNS)
    ]
    words = [ruling.word for ruling in rulings]
    found = (
        100 * words.count("REGRESSED") / CAMPAIGNS,
        100 * words.count("PASS") / CAMPAIGNS,
        len(COURSES) * float(np.mean([ruling.rounds for ruling in rulings])),
    )
    # Two simulations of 1,000: the standard error of a difference is at most 2.2 points. What the
    # published one drew scores from is not known in full, so that more than that may remain: here
    # the model of `courses`, which differs most at .10 (1 % PASS where 4 to 5 % were published).
    assert found[0] == pytest.approx(regressed, abs=6.0), found
    assert found[1] == pytest.approx(passed, abs=6.0), found
    assert found[2] == pytest.approx(trials, rel=0.12), found
    if drop >= 0.10:
        assert found[1] <= 5.0 + 2.1, found
    if drop <= tolerate:
        assert found[0] <= 5.0 + 2.1, found
