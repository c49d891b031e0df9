from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.results.row import Row

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def make_row() -> Callable[..., Row]:
    """A row of a trial that reached three of four waypoints, with some columns changed."""

    def make(**changes: Any) -> Row:
        columns: dict[str, Any] = {
            "trial_id": "hurdles-one-000",
            "suite": "hurdles",
            "scene": "hurdles/one",
            "task": "hurdles",
            "seed_index": 0,
            "seed": 2**64 - 1,
            "policy": "go1-parkour",
            "status": "ok",
            "outcome": "fell",
            "end_reason": "roll",
            "completed": False,
            "fraction": 0.75,
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
