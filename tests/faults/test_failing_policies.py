"""A policy that fails, fails: what repeats in a fresh process is its result, and nobody's error.

One policy misbehaves in every trial in a way of its own, which it reads from a file by its seed.
"""

import json

import numpy as np
import pytest

from nw_eval.cli.verbs.replay import replay_line
from nw_gate.absolute import judge
from nw_gate.results.row import rows_digest
from nw_gate.settings import Gate
from nw_sim.rollout.replaying.takeover import replay

CARD = """\
nw-policy: 1
name: failing
robot: go1
adapter: python:failing:Failing
control:
  action: joint_position_offset
  scale: 0.25
  torque_limits: 1.0e+12
observations:
  proprio: {sensor: proprio, layout: parkour53}
"""

CODE = '''\
import json
import os
import signal
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent


def nothing(count):
    return np.zeros(12)


def raising(kind, *arguments):
    def act(count):
        raise kind(*arguments)
    return act


def telling(count):
    raise ValueError(f"{object()} of process {os.getpid()}")


def shaking(count):
    return np.full(12, 3e6 if count % 2 else -3e6)


def dying(number):
    return lambda count: os.kill(os.getpid(), number)


def first(one, other):
    """Do one thing in the first process that gets here, and another in the next ones."""
    def act(count, trial):
        mark = HERE / f"seen-{trial}"
        return other(count) if mark.exists() else one(count)
    act.knows_its_trial = True
    return act


WAYS = {
    "fine": nothing,
    "exit 0": lambda count: sys.exit(0),
    "exit 7": lambda count: sys.exit(7),
    "interrupt": raising(KeyboardInterrupt),
    "generator": raising(GeneratorExit),
    "telling": telling,
    "huge": lambda count: np.full(12, 1e30),
    "shaking": shaking,
    "reset": nothing,
    "killed": dying(signal.SIGKILL),
    "flaky": first(raising(ValueError, "once"), nothing),
    "fickle": first(raising(ValueError, "once"), lambda count: np.full(12, np.nan)),
    "leaves 0": lambda count: os._exit(0),
    "leaves 7": lambda count: os._exit(7),
    "error then leaves": first(raising(ValueError, "once"), lambda count: os._exit(7)),
    "unlucky": first(dying(signal.SIGKILL), raising(ValueError, "no gait")),
}


class Failing:
    def __init__(self, bundle):
        self.ways = json.loads((HERE / "ways.json").read_text())
        self.count = 0

    def reset(self, seed):
        self.trial, self.way = str(seed), self.ways[str(seed)]
        if self.way == "reset":
            raise RuntimeError("no memory of it")

    def act(self, observation):
        self.count += 1
        if self.count < 4:
            return np.zeros(12)
        act = WAYS[self.way]
        if hasattr(act, "knows_its_trial"):
            return act(self.count, self.trial)
        return act(self.count)
'''

EXCEPTIONS = {
    "exit 0": "SystemExit: 0",
    "exit 7": "SystemExit: 7",
    "interrupt": "KeyboardInterrupt",
    "generator": "GeneratorExit",
    "reset": "RuntimeError: no memory of it",
    "unlucky": "ValueError: no gait",
}


@pytest.fixture
def misbehave(tiny_run, tmp_path):
    """Return a maker of runs with a trial for each of the ways; and the ways by trial id."""

    def make(ways, **settings):
        folder = tmp_path / settings.get("name", "run") / "failing"
        folder.mkdir(parents=True)
        (folder / "policy.yaml").write_text(CARD)
        (folder / "failing.py").write_text(CODE)
        run = tiny_run("failing", trials=len(ways), code=folder, **settings)
        by_trial = dict(zip((job.trial for job in run.jobs), ways, strict=True))
        seeds = {seed_of(trial): way for trial, way in by_trial.items()}
        (folder / "ways.json").write_text(json.dumps(seeds))

        def heard(text):
            # The policy itself can leave no mark: it writes nowhere.
            for trial in by_trial:
                if f"{trial.id}: " in text and "again in a fresh process" in text:
                    (folder / f"seen-{seed_of(trial)}").touch()

        run.ears.heard = heard
        return run, {trial.id: way for trial, way in by_trial.items()}

    return make


def seed_of(trial):
    """Return what the policy is reset with, by which it knows its trial."""
    return str(int(trial.seed_sequence("policy").generate_state(1, np.uint32)[0]))


def by_way(outcome, ways):
    assert len(outcome.rows) == len(ways)
    return {ways[row.trial_id]: row for row in outcome.rows}


@pytest.mark.nightly
def test_what_a_policy_does_twice_is_its_result_and_what_a_machine_does_never_is(
    misbehave, workers
):
    ways = [*EXCEPTIONS, "fine", "huge", "shaking", "flaky", "fickle", "killed"]
    run, by_trial = misbehave(ways, duration=0.5)
    outcome = run.go(workers=2)
    rows = by_way(outcome, by_trial)
    assert workers() == []

    kinds = dict.fromkeys(EXCEPTIONS, "exception") | {"huge": "action", "shaking": "diverged"}
    for way, kind in kinds.items():
        row = rows[way]
        said = (row.status, row.outcome, row.end_reason, row.success, row.completed, row.attempt)
        attempts = 3 if way == "unlucky" else 2  # What killed it first was not the policy.
        assert said == ("ok", "policy_failed", kind, 0.0, False, attempts), way
        assert EXCEPTIONS.get(way, "") in row.error_text, way
        assert row.steps == (0 if way == "reset" else row.steps if way == "shaking" else 3)
        assert row.waypoints_total == (0 if way == "reset" else rows["fine"].waypoints_total)
    assert "target of 2.5e+29 for joint" in rows["huge"].error_text
    assert "physics failed at" in rows["shaking"].error_text

    assert (rows["fine"].outcome, rows["fine"].attempt) == ("timeout", 1)
    assert (rows["flaky"].outcome, rows["flaky"].attempt) == ("timeout", 2)
    assert (rows["flaky"].error_type, rows["flaky"].error_text) == ("", "")
    fickle = rows["fickle"]
    assert (fickle.status, fickle.outcome, fickle.success) == ("error", "policy_error", None)
    assert "nan" in fickle.error_text
    assert fickle.error_text.endswith("act raised ValueError: once")
    killed = rows["killed"]
    assert (killed.status, killed.outcome, killed.end_reason) == ("error", "crashed", "error")
    assert (killed.attempt, killed.success) == (2, None)
    assert sorted(row.trial_id for row in run.ears.rows) == sorted(by_trial)

    for way in ("exit 0", "huge", "shaking"):
        again = replay(run.folder.path / rows[way].mcap_path, allow_code=True)
        assert again.is_identical, replay_line(again.report)
        assert "policy_failed after" in replay_line(again.report)
    with pytest.raises(KeyboardInterrupt):  # Here it may be Ctrl-C.
        replay(run.folder.path / rows["interrupt"].mcap_path, allow_code=True)

    scene = run.jobs[0].trial.scene
    only = [row for row in outcome.rows if row.outcome == "policy_failed"]
    verdict = judge(only, Gate(success_rate=0.9), {scene: len(only)})
    assert (verdict.verdict, verdict.errors) == ("REGRESSED", 0)
    verdict = judge([*only, killed], Gate(success_rate=0.9), {scene: len(only) + 1})
    assert verdict.verdict == "INFRASTRUCTURE"
    assert "killed by SIGKILL" in verdict.reasons[0]


def test_a_run_cut_between_a_failure_and_its_repeat_goes_on_to_the_same_rows(misbehave):
    run, by_trial = misbehave(["telling", "fine"])
    whole = run.go(workers=2)
    told = by_way(whole, by_trial)["telling"]
    assert "ValueError: <object object at 0x...> of process" in told.error_text
    lines = run.folder.journal.read_bytes().splitlines(keepends=True)
    attempts = [json.loads(line)["row"] for line in lines[1:]]
    first, again = (row for row in attempts if row["trial_id"] == told.trial_id)
    columns = ("attempt", "status", "outcome", "end_reason", "success")
    assert [first[name] for name in columns] == [1, "error", "policy_error", "exception", None]
    assert [again[name] for name in columns] == [2, "ok", "policy_failed", "exception", 0.0]

    run.folder.journal.write_bytes(b"".join(line for line in lines if b'"attempt":2' not in line))
    resumed = run.go(workers=1, resume=True)
    retold = by_way(resumed, by_trial)["telling"]
    assert rows_digest(resumed.rows) == rows_digest(whole.rows)
    assert (retold.attempt, retold.outcome) == (2, "policy_failed")
    assert retold.error_text != told.error_text, "it names the process, and counts for nothing"


@pytest.mark.nightly
def test_a_policy_that_ends_its_process_has_failed(misbehave):
    run, by_trial = misbehave(["leaves 0", "leaves 7", "fine", "error then leaves"])
    rows = by_way(run.go(workers=2), by_trial)
    for way in ("leaves 0", "leaves 7"):
        row = rows[way]
        said = (row.status, row.outcome, row.end_reason, row.success, row.attempt)
        assert said == ("ok", "policy_failed", "exit", 0.0, 2)
        assert f"exit code {way[-1]}" in row.error_text
        assert (row.error_type, row.waypoints_total, row.mcap_path) == ("crashed", 0, "")
    assert rows["fine"].attempt == 1
    other = rows["error then leaves"]
    assert (other.status, other.outcome, other.end_reason) == ("error", "crashed", "exit")
    assert "act raised ValueError: once" in other.error_text
