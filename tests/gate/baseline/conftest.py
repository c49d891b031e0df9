from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.gate.baseline.draw import draw_starts
from nw_eval.results.bank import Manifest, Panel, PanelInfo, SavedBank, Start
from nw_eval.results.bank.manifest import BankPolicy, key_of, machine_of
from nw_eval.results.provenance import CodeInfo, MachineInfo, PolicyInfo, RunInfo, SceneInfo
from nw_eval.results.row import Row
from nw_eval.suite import new_suite

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from nw_eval.results.bank import Stratum

    Scores = Mapping[str | Stratum, Sequence[float | None]]

ENGINE = {"mujoco": "4.0.0", "embreex": "4.4", "renderer": "cpu gsplat-1.5", "cpu": "zen 4"}


def stratum_of(name: str | Stratum) -> Stratum:
    return (name, ()) if isinstance(name, str) else name


@pytest.fixture
def make_run() -> Callable[..., RunInfo]:
    """Provenance of a candidate's run: the first trials of each scene, or drawn from a bank."""

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
        return RunInfo(**{**facts, **changes})

    return make


@pytest.fixture
def make_bank() -> Callable[..., SavedBank]:
    """A bank that holds for a run, from the baseline's successes on every start of each scene."""

    def make(run: RunInfo, scores: Scores, *, outcome: str = "fell", **changes: Any) -> SavedBank:
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
            "policy": BankPolicy(
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
        return SavedBank(manifest=manifest, panels=panels)

    return make


@pytest.fixture
def run_rows() -> Callable[..., list[Row]]:
    """Rows of a run from the candidate's successes by start; None is a crash."""

    def make(run: RunInfo, scores: Scores) -> list[Row]:
        return [
            _row(run, stratum_of(name), index, value)
            for name, values in scores.items()
            for index, value in enumerate(values)
        ]

    return make


@pytest.fixture
def drawn_rows() -> Callable[..., list[Row]]:
    """Rows of a run that drew its starts from a bank, from successes in the order of the rounds."""

    def make(run: RunInfo, scores: Scores) -> list[Row]:
        assert run.drawn_from is not None
        strata = {stratum_of(name): values for name, values in scores.items()}
        order = draw_starts(
            strata, run.drawn_from, candidate=run.drawn_by, suite_digest=run.suite_digest
        )
        return [
            _row(run, stratum, order[stratum][number], value)
            for stratum, values in strata.items()
            for number, value in enumerate(values)
        ]

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
