from __future__ import annotations

import pytest

from nw_gate.results.baseline import (
    BaselineKey,
    BaselinePolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
)

LAPTOP, RUNNER = {"cpu": "znver4 1f0c77a2"}, {"cpu": "haswell 00112233"}


@pytest.fixture
def make_baseline():
    """A baseline of scenes by starts, every fourth with a fall, on one or two machine types."""
    return _baseline


def _baseline(
    *,
    scenes: int = 2,
    starts: int = 4,
    name: str = "shipped",
    machines: tuple[dict[str, str], ...] = (LAPTOP,),
    cells: tuple[tuple[tuple[str, float], ...], ...] = ((),),
    note: str = "",
) -> BaselineResults:
    names = [f"hurdles/place_{number:02}" for number in range(scenes)]
    panel = tuple(
        Start(
            scene=scene,
            task="hurdles",
            perturbation=cell,
            seed_index=index,
            success=1.0 if index % 4 else 0.5,
            completed=bool(index % 4),
            waypoints_reached=4 if index % 4 else 2,
            waypoints_total=4,
            outcome="completed" if index % 4 else "fell",
            end_reason="last waypoint" if index % 4 else "roll",
            trajectory=f"{hash((number, cell, index)) % 2**64:016x}",
        )
        for number, scene in enumerate(names)
        for cell in cells
        for index in range(starts)
    )
    manifest = Manifest(
        name=name,
        suite="hurdles",
        note=note,
        starts=starts,
        key=BaselineKey(
            suite_digest="aa" * 32,
            seed=20261,
            protocol="strict",
            scenes={name: f"{number:064x}" for number, name in enumerate(names)},
            simulator={"mujoco": "4.0.0", "renderer": "cpu gsplat-1.5"},
        ),
        policy=BaselinePolicy(
            name="go1-parkour", card_digest="bb" * 32, checkpoint_digest="cc" * 32
        ),
        panels=tuple(
            PanelInfo(
                machine=machine, saved="2026-11-22T10:00:00+00:00", by="anna", rows_digest="dd" * 32
            )
            for machine in machines
        ),
    )
    panels = tuple(Panel(machine=machine, starts=panel) for machine in machines)
    return BaselineResults(manifest=manifest, panels=panels)
