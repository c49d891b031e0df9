from __future__ import annotations

import random
from typing import Any

import pytest

from nw_gate.results.provenance import PolicyInfo, RunInfo, SceneInfo, code_info, machine_info
from nw_gate.results.row import Row


@pytest.fixture
def make_row():
    """A row of a trial that reached three of four waypoints, with some columns changed."""

    def make(**changes: Any) -> Row:
        columns: dict[str, Any] = {
            "trial_id": "hurdles-one-000",
            "suite": "hurdles",
            "scene": "hurdles/one",
            "task": "hurdles",
            "robot": "go1",
            "seed_index": 0,
            "seed": 2**64 - 1,
            "policy": "go1-parkour",
            "status": "ok",
            "outcome": "fell",
            "end_reason": "roll",
            "completed": False,
            "success": 0.75,
            "waypoints_reached": 3,
            "waypoints_total": 4,
            "waypoint_times": (1.1, 2.2, 3.3),
            "steps": 200,
            "sim_s": 4.0,
            "physics_s": 0.5,
            "render_s": 1.0,
            "policy_s": 0.1,
            "log_s": 0.2,
            "wall_s": 2.0,
            "checkpoint_digest": "cc" * 32,
            "scene_digest": "dd" * 32,
        }
        return Row(**{**columns, **changes})

    return make


@pytest.fixture
def mutated():
    """Damage as disks, networks and editors do it: flipped bits, cuts, exchanged parts."""
    return _mutated


@pytest.fixture
def run_json():
    """What a run of one scene says of itself."""
    return RunInfo(
        id="r",
        started="2026-11-21T11:00:05Z",
        suite_file="suites/hurdles.yaml",
        suite={"nw-eval": 1, "name": "hurdles"},
        suite_digest="aa" * 32,
        policy=PolicyInfo(name="p", checkpoint_digest="bb" * 32),
        scenes={"hurdles/one": SceneInfo(digest="cc" * 32, task="hurdles", trials=10)},
        code=code_info(),
        machine=machine_info(),
    )


def _mutated(data: bytes, rng: random.Random) -> bytes:
    """Return some bytes in which one of many things went wrong, and never the same bytes."""
    while True:
        other = _once(bytearray(data), rng)
        if other != data:
            return other


def _once(data: bytearray, rng: random.Random) -> bytes:
    kind = rng.choice(["flip", "flips", "cut", "insert", "exchange", "repeat", "remove", "zero"])
    at = rng.randrange(len(data))
    size = rng.choice([1, 4, 64, 512])
    if kind in {"flip", "flips"}:
        for _ in range(1 if kind == "flip" else 8):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "insert":
        data[at:at] = rng.randbytes(size)
    elif kind == "exchange":
        other = rng.randrange(len(data))
        data[at : at + size], data[other : other + size] = (
            data[other : other + size],
            data[at : at + size],
        )
    elif kind == "repeat":
        data[at:at] = data[at : at + size]
    elif kind == "remove":
        del data[at : at + size]
    else:
        data[at : at + size] = bytes(len(data[at : at + size]))
    return bytes(data)
