from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.suite import new_suite
from nw_gate.baseline.match import drawn_order
from nw_gate.results.baseline import (
    BaselinePolicy,
    BaselineResults,
    ControlArm,
    LoadedBaseline,
    Manifest,
    Panel,
    PanelInfo,
    Start,
    key_of,
    machine_of,
)
from nw_gate.results.provenance import (
    BaselineInfo,
    CodeInfo,
    MachineInfo,
    PolicyInfo,
    RunInfo,
    SceneInfo,
)
from nw_gate.results.row import Row

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_gate.results.baseline import Stratum

    Scores = Mapping[str | Stratum, Sequence[float | None]]
    Visits = Mapping[str | Stratum, Sequence[float | None] | float | None]

ENGINE = {"mujoco": "4.0.0", "rays": "nw-eval rays 1", "renderer": "cpu gsplat-1.5", "cpu": "zen 4"}


def stratum_of(name: str | Stratum) -> Stratum:
    return (name, ()) if isinstance(name, str) else name


@pytest.fixture
def make_run():
    """Provenance of a candidate's run: the first trials of each scene, or drawn from a baseline."""

    def make(scenes: Sequence[str], trials: int, **changes: Any) -> RunInfo:
        settings = {
            "nw-eval": 1,
            "name": "hurdles",
            "robot": "go1",
            "policy": "go1-parkour",
            "trials": trials,
            "seed": 20261,
            "scenes": ("hurdles/*",),
            **changes.pop("suite", {}),
        }
        suite = new_suite(settings)
        cells = len(suite.perturb.cells)
        facts: dict[str, Any] = {
            "id": "hurdles-go1-parkour-20261121T110005Z-01234567",
            "started": "2026-11-21T11:00:05Z",
            "finished": "2026-11-21T11:01:05Z",
            "wall_s": 60.0,
            "suite_file": "suites/hurdles.yaml",
            "suite": suite.model_dump(by_alias=True, mode="json"),
            "suite_digest": suite.digest,
            "policy": PolicyInfo(
                name="candidate", card_digest="c1" * 32, checkpoint_digest="cc" * 32
            ),
            "scenes": {
                name: SceneInfo(digest="dd" * 32, task="hurdles", trials=trials * cells)
                for name in scenes
            },
            "workers": 2,
            "renderer": "cpu gsplat-1.5",
            "code": CodeInfo(version="0.1.0", digest="ee" * 32),
            "machine": MachineInfo(
                host="ci", cpu="Some CPU", cores=2, system="Linux x86_64", python="3.11.7"
            ),
            "versions": {"mujoco": "4.0.0"},
            "engine": ENGINE,
        }
        run = RunInfo(**{**facts, **changes})
        if run.drawn_from is None:
            return run
        strata = [(scene, cell) for scene in scenes for cell in suite.perturb.cells]
        met = Counter(scene for scene, *_ in drawn_order(run, strata, trials))
        infos = {
            name: info.model_copy(update={"trials": met[name]}) for name, info in run.scenes.items()
        }
        return run.model_copy(update={"scenes": infos})

    return make


@pytest.fixture
def make_baseline():
    """A baseline that holds for a run, from its successes on every start of each scene."""

    def make(
        run: RunInfo, scores: Scores, *, outcome: str = "fell", **changes: Any
    ) -> BaselineResults:
        starts = tuple(
            Start(
                scene=stratum_of(name)[0],
                task="hurdles",
                perturbation=stratum_of(name)[1],
                seed_index=index,
                success=value or 0.0,
                completed=value == 1.0,
                waypoints_reached=round(4 * (value or 0.0)),
                waypoints_total=4,
                outcome="completed" if value == 1.0 else outcome,
                end_reason="",
                trajectory="0" * 16,
            )
            for name, values in sorted(scores.items(), key=lambda item: stratum_of(item[0]))
            for index, value in enumerate(values)
        )
        facts: dict[str, Any] = {
            "name": "shipped",
            "suite": "hurdles",
            "starts": max(len(values) for values in scores.values()),
            "key": key_of(run),
            "policy": BaselinePolicy(
                name="go1-act-rgb", card_digest="b1" * 32, checkpoint_digest="bb" * 32
            ),
            "panels": (
                PanelInfo(
                    machine=machine_of(run),
                    saved="2026-11-20T09:00:00Z",
                    by="ci",
                    rows_digest="ff" * 32,
                ),
            ),
        }
        manifest = Manifest(**{**facts, **changes})
        panels = tuple(Panel(machine=info.machine, starts=starts) for info in manifest.panels)
        return BaselineResults(manifest=manifest, panels=panels)

    return make


@pytest.fixture
def run_rows():
    """Rows of a run from the candidate's successes by start; None is a crash."""

    def make(run: RunInfo, scores: Scores) -> list[Row]:
        return [
            _row(run, stratum_of(name), index, value)
            for name, values in scores.items()
            for index, value in enumerate(values)
        ]

    return make


@pytest.fixture
def drawn_rows():
    """Rows of a run in the order in which its trials were drawn, as `drawn` gives them."""
    return drawn


def drawn(run: RunInfo, scores: Visits, first: int | None = None) -> list[Row]:
    """Return rows of the trials of a run's budget, in the drawn order.

    Args:
        run: the run.
        scores: successes of each scene: of all of its trials, or of its first, second, ... one;
            then it has no more trials than that. None is a crash.
        first: how many trials of the order have ended; all if None.
    """
    given = {stratum_of(name): values for name, values in scores.items()}
    met = dict.fromkeys(given, 0)
    rows: list[Row] = []
    for scene, cell, start in drawn_order(run, sorted(given), run.suite["trials"])[:first]:
        values, number = given[scene, cell], met[scene, cell]
        met[scene, cell] += 1
        if values is None or isinstance(values, float):
            rows.append(_row(run, (scene, cell), start, values))
        elif number < len(values):
            rows.append(_row(run, (scene, cell), start, values[number]))
    return rows


@pytest.fixture
def make_against():
    """A baseline as runs are compared with it."""

    def make(baseline: BaselineResults, control: ControlArm | None = None) -> LoadedBaseline:
        info = BaselineInfo(name=baseline.manifest.name, path="shipped.parquet", sha256="5a" * 32)
        return LoadedBaseline(info=info, results=baseline, content=b"", control=control)

    return make


@pytest.fixture
def make_control():
    """Trials of a baseline's own policy beside a candidate; arguments as for `drawn`."""

    def make(
        run: RunInfo, baseline: BaselineResults, scores: Visits, first: int | None = None
    ) -> ControlArm:
        own = baseline.manifest.policy
        policy = PolicyInfo(
            name=own.name, card_digest=own.card_digest, checkpoint_digest=own.checkpoint_digest
        )
        beside = run.model_copy(update={"policy": policy, "drawn_for": run.drawn_by})
        rows = drawn(beside, scores, first)
        return ControlArm(run=beside, rows=tuple(replace(row, arm="baseline") for row in rows))

    return make


def _row(run: RunInfo, stratum: Stratum, index: int, value: float | None) -> Row:
    scene, cell = stratum
    changed = "".join(f"-{axis}_{level!r}" for axis, level in cell)
    return Row(
        trial_id=f"{scene.replace('/', '-')}-{index:03d}{changed}",
        suite="hurdles",
        scene=scene,
        task="hurdles",
        robot="go1",
        seed_index=index,
        seed=index,
        policy=run.policy.name,
        perturbation=cell,
        status="error" if value is None else "ok",
        outcome="crashed" if value is None else "completed" if value == 1.0 else "fell",
        end_reason="",
        completed=value == 1.0,
        success=value,
        waypoints_reached=round(4 * (value or 0.0)),
        waypoints_total=4,
        waypoint_times=tuple(map(float, range(round(4 * (value or 0.0))))),
        steps=200,
        sim_s=4.0,
        physics_s=0.5,
        render_s=1.0,
        policy_s=0.1,
        log_s=0.2,
        wall_s=2.0,
        checkpoint_digest=run.policy.checkpoint_digest,
        scene_digest="dd" * 32,
        mcap_path=f"mcap/{scene}/{index}.mcap",
        error_text="signal 11" if value is None else "",
    )
