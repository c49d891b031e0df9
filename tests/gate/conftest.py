from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from nw_gate.results.row import Row

if TYPE_CHECKING:
    from collections.abc import Sequence


@pytest.fixture
def run_scene():
    """Rows of one scene from the waypoints (of four) that its trials reached; None is a crash."""

    def make(scene: str, reached: Sequence[int | None]) -> list[Row]:
        return [
            Row(
                trial_id=f"{scene.replace('/', '-')}-{index:03d}",
                suite="hurdles",
                scene=scene,
                task="hurdles",
                robot="go1",
                seed_index=index,
                seed=index,
                policy="go1-parkour",
                status="error" if count is None else "ok",
                outcome="crashed" if count is None else "completed" if count == 4 else "fell",
                end_reason="",
                completed=count == 4,
                success=None if count is None else count / 4,
                waypoints_reached=count or 0,
                waypoints_total=4,
                steps=200,
                sim_s=4.0,
                physics_s=0.5,
                render_s=1.0,
                policy_s=0.1,
                log_s=0.2,
                wall_s=2.0,
                checkpoint_digest="cc" * 32,
                scene_digest="dd" * 32,
                error_text="signal 11" if count is None else "",
            )
            for index, count in enumerate(reached)
        ]

    return make
