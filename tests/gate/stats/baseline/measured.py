"""Waypoints reached in real rollouts of the hurdles suite.

HURDLES are ten trials of `go1-parkour` in each of 16 scenes, as the method's figures were published
for. `real_runs.json` has thirty trials in each from the same starts, by `go1-parkour` and by a copy
whose weights have 30 % noise.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from nw_gate.stats.power import SceneCounts

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
"""How many trials ended after 0, 1, ... waypoints; mean success .938."""

SEEN = [SceneCounts(counts=np.array(counts, dtype=np.int64)) for counts in HURDLES]


def real_run(policy: str) -> np.ndarray:
    """Return success in the scenes from each start, shape (S, M)."""
    path = Path(__file__).with_name("real_runs.json")
    scenes = json.loads(path.read_text(encoding="utf-8")).values()
    return np.array([[int(digit) for digit in scene[policy]] for scene in scenes]) / np.array(
        [[scene["waypoints"]] for scene in scenes]
    )
