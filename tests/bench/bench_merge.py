"""A hundred thousand drawn rows, or as many as are asked for: planned, written, merged, judged.

No simulator runs: rows are drawn. Each part is written by a process of its own, as `run --shard`
writes what the cache of trials has: the rows are there together, and are on disk together. Then
`nw-eval merge` puts the parts together, judges the run by a bar, and writes its pages. The seconds
of all of it, and the most memory that any of its processes had. `nw-eval verify` looks at its files
then, which is no part of it. What a row that comes alone waits
for the disk is said beside it, and how fast the machine is at this moment: a bare loop.

    python tests/bench/bench_merge.py [ROWS]
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nw_eval.engine.order import shard_of
from nw_eval.suite import expand, new_suite
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
from nw_gate.results.request import Shard
from nw_gate.results.row import Row
from nw_gate.results.run_folder import RunFolder

SECONDS, BYTES = 30.0, 2**30  # at most
NW_EVAL = str(Path(sys.executable).with_name("nw-eval"))
SCENES, PARTS, WAYPOINTS = 64, 4, 4
ROUNDS = int(os.environ.get("ROUNDS", "1563"))
AT_ONCE = 2000  # rows
SUITE = new_suite(
    {
        "nw-eval": 1,
        "name": "bench",
        "robot": "go1",
        "policy": "drawn",
        "trials": ROUNDS,
        "seed": 1,
        "scenes": ("*",),
        "gate": {"success_rate": 0.75},
    }
)


class Place:
    """A scene, as trials need it."""

    def __init__(self, number):
        self.name, self.task, self.digest = f"place/{number:02d}", "hurdles", "dd" * 32


def drawn_row(trial, reached):
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
        policy="drawn",
        status="ok",
        outcome="completed" if done else "fell",
        end_reason="all waypoints" if done else "roll",
        completed=done,
        success=reached / WAYPOINTS,
        waypoints_reached=reached,
        waypoints_total=WAYPOINTS,
        waypoint_times=tuple(float(k) for k in range(reached)),
        steps=400,
        sim_s=8.0,
        physics_s=0.5 + int(trial.identity[:4], 16) / 1e6,
        render_s=0.0,
        policy_s=0.1 + int(trial.identity[4:8], 16) / 1e6,
        log_s=0.1 + int(trial.identity[8:12], 16) / 1e6,
        wall_s=1.0 + int(trial.identity[12:16], 16) / 1e6,
        state_digest=trial.identity,
        action_digest=trial.identity[::-1],
        checkpoint_digest="cc" * 32,
        scene_digest=trial.scene_digest,
        host="bench",
    )


def provenance(index, shard, trials):
    """Return run.json of a part."""
    counts = Counter(trial.scene for trial in trials)
    return RunInfo(
        id=f"part-{index}",
        started="2026-11-22T00:00:00Z",
        finished="2026-11-22T01:00:00Z",
        wall_s=3600.0,
        suite_file="bench.yaml",
        suite=SUITE.model_dump(by_alias=True, mode="json"),
        suite_digest=SUITE.digest,
        policy=PolicyInfo(name="drawn", card_digest="c1" * 32, checkpoint_digest="cc" * 32),
        scenes={
            scene.name: SceneInfo(digest=scene.digest, task=scene.task, trials=counts[scene.name])
            for scene in map(Place, range(SCENES))
        },
        shard=shard,
        code=code_info(),
        machine=machine_info(),
        engine={"mujoco": "4.0.0", "renderer": "cpu", "cpu": "some"},
    )


def write_part(folder, index):
    """Write the folder of a part, row by row, and print the seconds of what a run does of it."""
    began = clocks()
    scenes = list(map(Place, range(SCENES)))
    trials, shard = shard_of(expand(SUITE, scenes), Shard(index=index, count=PARTS))
    planned = clocks()
    info = provenance(index, shard, trials)
    reached = np.random.default_rng(index).binomial(WAYPOINTS, 0.95, size=len(trials)).tolist()
    header = JournalHeader(
        suite_digest=info.suite_digest,
        policy_digest=info.policy.card_digest,
        scene_digests={scene.name: scene.digest for scene in scenes},
        engine=info.engine,
    )
    at = RunFolder(path=folder)
    at.path.mkdir()
    writing = 0.0
    with Journal.create(at.journal, header) as journal:
        for first in range(0, len(trials), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            rows = [drawn_row(*each) for each in zip(trials[some], reached[some], strict=True)]
            drawn = clocks()
            journal.extend(rows)
            writing += clocks() - drawn
        written = clocks()
        write_run_info(at.run_json, write_trials(at, info, journal.rows))
    ended = clocks()
    print(*planned - began, *writing, *ended - written, alone(folder, header, rows[:100]))


def clocks():
    """Return wall and processor time, s."""
    return np.array([time.perf_counter(), time.process_time()])


def alone(folder, header, rows):
    """Return the seconds of a row that is written by itself."""
    with Journal.create(folder / "alone.jsonl", header) as journal:
        began = time.perf_counter()
        for row in rows:
            journal.append(row)
        return (time.perf_counter() - began) / len(rows)


def loop():
    """Return the processor time of a loop of 20 million additions."""
    began, total = time.process_time(), 0
    for number in range(20_000_000):
        total += number
    return time.process_time() - began


def timed(*words):
    """Run a command; return what it printed, its wall and processor time, and its most bytes."""
    began = time.perf_counter()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as child:
        printed = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0, printed
    seconds = np.array([time.perf_counter() - began, usage.ru_utime + usage.ru_stime])
    return printed, seconds, usage.ru_maxrss * 1024


def main():
    if len(sys.argv) == 2:  # The parts, and this process itself, read it from there.
        os.environ["ROUNDS"] = str(int(sys.argv[1]) // SCENES)
        os.execv(sys.executable, [sys.executable, __file__])
    if len(sys.argv) == 3:
        gc.set_threshold(100_000, 50, 100)  # As a verb has it: `cli.process`.
        write_part(Path(sys.argv[1]), int(sys.argv[2]))
        return
    before = loop()
    with TemporaryDirectory() as name:
        parts = [str(Path(name) / f"part-{index}") for index in range(1, PARTS + 1)]
        written = [timed(sys.executable, __file__, part, part[-1]) for part in parts]
        merged = str(Path(name) / "merged")
        _, merging, merger = timed(NW_EVAL, "merge", *parts, "--out", merged)
        _, verifying, verifier = timed(NW_EVAL, "verify", merged, "--offline")
    numbers = np.array([[float(x) for x in printed.split()] for printed, _, _ in written])
    shares, single = numbers[:, :-1].sum(axis=0).reshape(3, 2), numbers[:, -1].mean()
    writer = max(size for _, _, size in written)
    print(f"{SCENES * ROUNDS} rows in {PARTS} parts, one after the other")
    print(f"{'':16} {'wall s':>7} {'processor s':>11} {'MB':>6}")
    total, most = shares.sum(axis=0) + merging, max(writer, merger)
    for what, (wall, used), size in (
        ("plan", shares[0], writer),
        ("journal", shares[1], writer),
        ("parquet", shares[2], writer),
        ("merge and judge", merging, merger),
        ("all", total, most),
        ("verify", verifying, verifier),
    ):
        print(f"{what:16} {wall:7.1f} {used:11.1f} {size / 1e6:6.0f}")
    seconds = SECONDS * SCENES * ROUNDS / 1e5
    held = total[0] <= seconds and most <= BYTES
    answer = "yes" if held else "NO"
    print(f"{'target, at most':16} {seconds:7.1f} {'':11} {BYTES / 1e6:6.0f}  {answer}")
    print(f"a row alone: {1000 * single:.2f} ms; loop: {before:.2f} s, {loop():.2f} s")
    sys.exit(not held)


if __name__ == "__main__":
    main()
