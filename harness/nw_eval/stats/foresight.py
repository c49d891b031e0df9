"""How often runs that were not made would be passed or convicted by the bounds of `betting`.

Runs are drawn from `courses` and judged as real ones are. The draws are seeded by what was seen, so
the same rows foresee the same, digit by digit.
"""

from __future__ import annotations

from hashlib import sha256
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.stats.betting import log_bets, log_mixture
from nw_eval.stats.courses import Floats, SceneCounts, chances_at, ends, likely_chances

RUNS = 2000
"""Simulated runs: the standard error of a share is at most 1.1 %."""


class Shares(NamedTuple):
    """Of simulated runs."""

    passed: float
    regressed: float


def shares_at(courses: list[SceneCounts], mean: float, *, bar: float, confidence: float) -> Shares:
    """Return how often runs like this one end, of a policy whose true success is `mean`.

    Runs have the same scenes and as many trials in each, with fresh starts.

    Args:
        courses: what was seen; its scenes keep their relative difficulty.
        mean: true success, scenes weighted equally, between 0 and 1.
        bar: what the lower bound must reach, and the upper one must not miss.
        confidence: of each bound; scenes `alone` share what is left of it for theirs.
    """
    chances = np.broadcast_to(chances_at(courses, mean), (RUNS, len(courses)))
    return _judge([_draw(courses, chances, 1, _rng(courses))], courses, bar, confidence)


def shares_after(
    courses: list[SceneCounts], times: int, *, bar: float, confidence: float
) -> Shares:
    """Return how often this run ends so, once there are `times` as many trials in every scene.

    The true success is not known, but drawn anew for each simulated run from what it may be after
    what was seen; a share is the chance that this run has to be decided.
    """
    rng = _rng(courses)
    fresh = _draw(courses, likely_chances(courses, RUNS, rng), times - 1, rng)
    seen = [np.broadcast_to(course.counts, (RUNS, len(course.counts))) for course in courses]
    return _judge([fresh, seen], courses, bar, confidence)


def runs_at(
    courses: list[SceneCounts],
    mean: float,
    *,
    stream: int,
    bar: float | None = None,
    confidence: float = 0.95,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return what each of `RUNS` simulated runs shows: its mean success, and whether it passes.

    Args:
        courses: as for `shares_at`, and so are mean and confidence.
        mean: true success.
        stream: runs of another one are drawn independently.
        bar: without one no run passes.
        confidence: of the lower bound.
    """
    chances = np.broadcast_to(chances_at(courses, mean), (RUNS, len(courses)))
    counts = _draw(courses, chances, 1, _rng(courses, stream))
    shown = [n @ course.values / course.trials for n, course in zip(counts, courses, strict=True)]
    passed = np.zeros(RUNS, dtype=bool)
    if bar is not None:
        passed, _ = _judged([counts], courses, bar, confidence)
    return np.mean(shown, axis=0), passed


def _rng(courses: list[SceneCounts], stream: int = 0) -> np.random.Generator:
    content = sha256(b"".join(course.counts.astype("<i8").tobytes() + b"|" for course in courses))
    if stream:
        content.update(str(stream).encode())
    return np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))


def _draw(
    courses: list[SceneCounts], chances: Floats, times: int, rng: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Return counts of ends in each scene, shape (runs, k + 1)."""
    return [
        rng.multinomial(times * course.trials, ends(chances[:, index], len(course.counts) - 1))
        for index, course in enumerate(courses)
    ]


def _judge(
    parts: list[list[NDArray[np.int64]]], courses: list[SceneCounts], bar: float, confidence: float
) -> Shares:
    """Return how many runs pass and are convicted."""
    passed, regressed = _judged(parts, courses, bar, confidence)
    return Shares(float(passed.mean()), float(regressed.mean()))


def _judged(
    parts: list[list[NDArray[np.int64]]], courses: list[SceneCounts], bar: float, confidence: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which runs pass and are convicted; a run's counts are the sum of its parts."""
    counts = [np.sum(part, axis=0) for part in zip(*parts, strict=True)]
    trials = [int(ended[0].sum()) for ended in counts]
    above = below = np.zeros(1)
    condemned = np.zeros(len(counts[0]), dtype=bool)
    level = -log(1.0 - confidence)
    stricter = level + log(max(1, sum(course.alone for course in courses)))
    for course, ended, n in zip(courses, counts, trials, strict=True):
        # As `betting` weighs scenes of different lengths.
        share = min(trials) / n
        above = above + ended @ log_bets(course.values, share, bar).T
        below = below + ended @ log_bets(1.0 - course.values, share, 1.0 - bar).T
        if course.alone:
            alone = ended @ log_bets(1.0 - course.values, 1.0, 1.0 - bar).T
            condemned |= log_mixture(alone) >= stricter
    passed = (log_mixture(above) >= level) & ~condemned
    regressed = (log_mixture(below) >= level) | condemned
    return passed, regressed
