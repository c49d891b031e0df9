"""Judging 10,000 rows against a baseline, from the shell: seconds of wall and of processor time.

No simulator runs: rows and baseline are drawn. A suite of 64 scenes in 160 rounds is judged against
a baseline of as many starts, and one of 8 perturbations in 20 rounds against a baseline of 60. Then
150, 300 and 600 scenes of 100 trials: the time of a row is to stay what it is.

    python tests/bench/bench_gate.py
"""

import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nw_eval.api.saved_run import saved_suite, saved_trials
from nw_eval.suite import new_suite
from nw_gate.results.baseline import (
    BaselinePolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
    key_of,
    machine_of,
)
from nw_gate.results.baseline_file import write_baseline
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, JournalHeader
from nw_gate.results.provenance import (
    PolicyInfo,
    RunInfo,
    SceneInfo,
    code_info,
    machine_info,
    write_run_info,
)
from nw_gate.results.row import Row
from nw_gate.results.run_folder import RunFolder

WANTED = 2.0  # seconds, at most
NW_EVAL = str(Path(sys.executable).with_name("nw-eval"))
WAYPOINTS = 4
FRICTIONS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25)


def provenance(rounds, starts, frictions, scenes=64):
    """Return run.json of a run of scenes that drew its starts from a baseline."""
    suite = new_suite(
        {
            "nw-eval": 1,
            "name": "bench",
            "robot": "go1",
            "policy": "drawn",
            "trials": rounds,
            "seed": 1,
            "scenes": ("*",),
            "perturb": {"friction": frictions},
            "gate": {"success_rate": 0.75, "max_drop": 0.1},
        }
    )
    cells = len(suite.perturb.cells)
    return RunInfo(
        id="bench",
        started="2026-11-22T00:00:00Z",
        finished="2026-11-22T00:01:00Z",
        wall_s=60.0,
        suite_file="bench.yaml",
        suite=suite.model_dump(by_alias=True, mode="json"),
        suite_digest=suite.digest,
        policy=PolicyInfo(name="drawn", card_digest="c1" * 32, checkpoint_digest="cc" * 32),
        scenes={
            f"place/{number:03d}": SceneInfo(
                digest="dd" * 32, task="hurdles", trials=rounds * cells
            )
            for number in range(scenes)
        },
        drawn_from=starts,
        code=code_info(),
        machine=machine_info(),
        engine={"mujoco": "4.0.0", "rays": "nw-eval rays 1", "renderer": "cpu", "cpu": "some"},
    )


def drawn_row(trial, run, reached):
    """Return the row of a trial that reached some waypoints."""
    done = reached == WAYPOINTS
    return Row(
        trial_id=trial.id,
        suite=trial.suite,
        scene=trial.scene,
        task=trial.task,
        robot="go1",
        seed_index=trial.index,
        seed=trial.seed,
        policy=run.policy.name,
        perturbation=trial.perturbation,
        status="ok",
        outcome="completed" if done else "fell",
        end_reason="",
        completed=done,
        success=reached / WAYPOINTS,
        waypoints_reached=reached,
        waypoints_total=WAYPOINTS,
        waypoint_times=tuple(float(k) for k in range(reached)),
        steps=400,
        sim_s=8.0,
        physics_s=0.5,
        render_s=1.0,
        policy_s=0.1,
        log_s=0.1,
        wall_s=2.0,
        state_digest="ab" * 32,
        action_digest="cd" * 32,
        checkpoint_digest=run.policy.checkpoint_digest,
        scene_digest=trial.scene_digest,
    )


def drawn_baseline(run, starts, cells, rng):
    """Return a baseline that holds for a run."""
    kept = []
    for scene in run.scenes:
        for cell in cells:
            for index, reached in enumerate(rng.binomial(WAYPOINTS, 0.95, size=starts).tolist()):
                kept.append(
                    Start(
                        scene=scene,
                        task="hurdles",
                        perturbation=cell,
                        seed_index=index,
                        success=reached / WAYPOINTS,
                        completed=reached == WAYPOINTS,
                        waypoints_reached=reached,
                        waypoints_total=WAYPOINTS,
                        outcome="completed" if reached == WAYPOINTS else "fell",
                        end_reason="",
                        trajectory="0" * 16,
                    )
                )
    machine = machine_of(run)
    info = PanelInfo(machine=machine, saved="2026-11-22T00:00:00Z", by="", rows_digest="ff" * 32)
    manifest = Manifest(
        name="baseline",
        suite="bench",
        starts=starts,
        key=key_of(run),
        policy=BaselinePolicy(name="old", card_digest="b1" * 32, checkpoint_digest="bb" * 32),
        panels=(info,),
    )
    return BaselineResults(manifest=manifest, panels=(Panel(machine=machine, starts=tuple(kept)),))


def write(folder, rounds, starts, frictions, chance, scenes=64):
    """Write a run and a baseline, and return how many rows there are."""
    rng = np.random.default_rng(1)
    run = provenance(rounds, starts, frictions, scenes)
    suite = saved_suite(run)
    write_baseline(
        folder / "baseline.parquet", drawn_baseline(run, starts, suite.perturb.cells, rng)
    )
    at = RunFolder(path=folder / "run")
    at.path.mkdir()
    trials = saved_trials(run, suite)
    reached = rng.binomial(WAYPOINTS, chance, size=len(trials)).tolist()
    rows = [drawn_row(trial, run, k) for trial, k in zip(trials, reached, strict=True)]
    header = JournalHeader(
        suite_digest=run.suite_digest,
        policy_digest="c1" * 32,
        scene_digests={name: scene.digest for name, scene in run.scenes.items()},
        engine=run.engine,
    )
    with Journal.create(at.journal, header) as journal:
        journal.extend(rows)
    write_run_info(at.run_json, write_trials(at, run, rows))
    return len(rows)


def seconds(*words):
    """Return the least wall and processor time of three runs of the command."""
    found = []
    for _ in range(3):
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        ended = subprocess.run([NW_EVAL, *words], capture_output=True, text=True, check=False)
        wall = time.perf_counter() - began
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert ended.returncode in {0, 1, 3}, ended.stderr
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        found.append((wall, used))
    return min(found)


def main():
    print(f"{'rows':>6} {'starts':>6} {'drop':>5} {'wall s':>7} {'processor s':>11}")
    slowest = 0.0
    for rounds, starts, frictions in ((160, 160, ()), (20, 60, FRICTIONS)):
        for chance in (0.95, 0.92):
            with TemporaryDirectory() as name:
                folder = Path(name)
                rows = write(folder, rounds, starts, frictions, chance)
                baseline = str(folder / "baseline.parquet")
                wall, used = seconds("gate", str(folder / "run"), "--baseline", baseline)
            drop = 0.95 - chance
            print(f"{rows:>6} {starts:>6} {drop:>5.2f} {wall:>7.2f} {used:>11.2f}")
            slowest = max(slowest, wall)
    many()
    assert slowest <= WANTED, f"{slowest:.2f} s"


def many():
    """Print what judging takes of 150, 300 and 600 scenes, by bar and baseline, and a report."""
    print(
        f"{'scenes':>6} {'rows':>6} {'verb':>8} {'wall s':>7} {'processor s':>11} {'ms a row':>8}"
    )
    for scenes in (150, 300, 600):
        with TemporaryDirectory() as name:
            folder = Path(name)
            rows = write(folder, 100, 100, (), 0.95, scenes)
            run, baseline = str(folder / "run"), str(folder / "baseline.parquet")
            for words in (("gate", run), ("gate", run, "--baseline", baseline), ("report", run)):
                wall, used = seconds(*words)
                verb = "baseline" if len(words) > 2 else words[0]
                print(
                    f"{scenes:>6} {rows:>6} {verb:>8} {wall:>7.2f} {used:>11.2f} "
                    f"{1000 * used / rows:>8.3f}"
                )


if __name__ == "__main__":
    main()
