"""Splats of built-in scenes are built beside other things, and are what one process builds."""

import sys
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import pytest

from nw_base.errors import SceneError
from nw_base.trials import Trial
from nw_eval import api
from nw_eval.engine.local import LocalWorkers
from nw_eval.engine.prepare import SplatBuilders
from nw_gate.results.journal import read_journal
from nw_gate.results.row import rows_digest
from nw_places.entry import BuiltInSplat
from nw_sim.catalogue import open_scene

NAMES = ("hurdles/one_low_carpet", "hurdles/three_low", "hurdles/two_logs_park")
ANSWERING = """#!/bin/sh
while read name; do
  echo "$name" >> {heard}
  while [ ! -e {goes_on} ]; do sleep 0.01; done
  echo 0.5
  echo {answer}
done
"""


class Heard:
    def __init__(self):
        self.shares = {}

    def scene(self, name, fraction):
        self.shares.setdefault(name, []).append(fraction)


class Processes:
    """What stands for the processes that build: it answers, and says what it was asked for."""

    def __init__(self, folder, monkeypatch):
        self.heard, self.goes_on = folder / "heard", folder / "goes_on"
        self._program = folder / "program"
        monkeypatch.setattr(sys, "executable", str(self._program))
        self.answer("done")
        self.goes_on.touch()

    def answer(self, word):
        paths = {"heard": self.heard, "goes_on": self.goes_on}
        self._program.write_text(ANSWERING.format(answer=word, **paths))
        self._program.chmod(0o700)

    @property
    def asked(self):
        return self.heard.read_text().split() if self.heard.exists() else []


@pytest.fixture(autouse=True)
def _empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def processes(tmp_path, monkeypatch):
    return Processes(tmp_path, monkeypatch)


def scenes(count=3):
    return [open_scene(name) for name in NAMES[:count]]


def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.nightly
def test_two_processes_write_what_one_writes():
    heard = Heard()
    with SplatBuilders(scenes(2), count=2, listener=heard) as builders:
        builders.wait()
    built = [scene.splat.path.read_bytes() for scene in scenes(2)]
    wanted = dict.fromkeys(NAMES[:2], 1.0)
    assert {name: shares[-1] for name, shares in heard.shares.items()} == wanted
    for scene, bits in zip(scenes(2), built, strict=True):
        scene.splat.path.unlink()
        assert scene.splat_store().read_bytes() == bits


def test_scenes_are_built_in_the_order_in_which_they_are_needed(processes):
    heard = Heard()
    with SplatBuilders(scenes(), count=1, listener=heard) as builders:
        builders.wait()
        assert not builders.missing
    assert processes.asked == list(NAMES)
    assert heard.shares == {name: [0.5] for name in NAMES}


def test_the_scene_that_somebody_waits_for_is_built_before_others(processes):
    processes.goes_on.unlink()
    with SplatBuilders(scenes(), count=1) as builders:
        until(lambda: processes.asked)
        builders.want(NAMES[2])
        processes.goes_on.touch()
        builders.wait()
    assert processes.asked == [NAMES[0], NAMES[2], NAMES[1]]


def test_no_build_begins_that_is_not_allowed(processes):
    processes.goes_on.unlink()
    with SplatBuilders(scenes(), count=2) as builders:
        until(lambda: len(processes.asked) == 2)
        builders.allow(0)
        processes.goes_on.touch()
        until(lambda: set(builders.missing) == {NAMES[2]})
        assert builders.has_more
        time.sleep(0.05)
        assert len(processes.asked) == 2
        builders.allow(1)
        until(lambda: not builders.missing)


def test_on_demand_nothing_is_built_that_nobody_waits_for(processes):
    with SplatBuilders(scenes(), count=2, on_demand=True) as builders:
        builders.allow(2)
        assert not builders.has_more
        builders.want(NAMES[1])
        until(lambda: set(builders.missing) == {NAMES[0], NAMES[2]})
    assert processes.asked == [NAMES[1]]


@pytest.mark.usefixtures("processes")
def test_beside_a_compiler_idle_cores_build_what_may_be_needed():
    with SplatBuilders(scenes(), count=2, on_demand=True) as builders:
        with builders.beside_compiler():
            until(lambda: not builders.missing)
        assert builders._allowed == 0


@pytest.mark.parametrize("how", ["says so", "is gone"])
def test_what_a_process_cannot_build_is_built_here_and_named(processes, monkeypatch, how):
    def store(self, _progress=None):
        raise SceneError(f"{self.place.name}: no such paint")

    monkeypatch.setattr(BuiltInSplat, "store", store)
    if how == "is gone":
        monkeypatch.setattr(sys, "executable", "/bin/false")
    processes.answer("failed")
    with SplatBuilders(scenes(), count=1) as builders:
        builders.wait()
        assert set(builders.missing) == set(NAMES)
        with pytest.raises(SceneError, match=f"{NAMES[0]}: no such paint"):
            builders.repair()


def test_what_is_built_here_is_missing_no_more(processes, monkeypatch):
    monkeypatch.setattr(BuiltInSplat, "store", lambda _self, _progress=None: None)
    processes.answer("failed")
    with SplatBuilders(scenes(), count=1) as builders:
        builders.wait()
        for left in (NAMES[1:], NAMES[2:], ()):
            builders.repair()
            assert set(builders.missing) == set(left)
        builders.repair()


def test_their_end_is_not_waited_for_when_nobody_needs_them_any_more(processes):
    processes.goes_on.unlink()
    with SplatBuilders(scenes(), count=2) as builders:
        until(lambda: len(processes.asked) == 2)
        assert [process.poll() for process in builders._processes] == [None, None]
    assert [process.returncode for process in builders._processes] == [-9, -9]
    assert len(processes.asked) == 2
    builders.repair()  # What was cut short is no fault.


def test_no_process_is_started_where_nothing_is_missing(monkeypatch):
    monkeypatch.setattr("nw_places.entry.BuiltInSplat.path", Path(__file__))
    with SplatBuilders(scenes(), count=2) as builders:
        builders.wait()
        assert not builders._processes
        assert not builders.missing


class Held:
    """Builders of which a test says what is missing."""

    on_demand = False

    def __init__(self, *missing, has_more=True):
        self.missing, self.has_more, self.wanted, self.allowed = set(missing), has_more, [], None

    def want(self, scene):
        if scene in self.missing and scene not in self.wanted:
            self.wanted.append(scene)

    def allow(self, count):
        self.allowed = count


def queued(builders, *trials):
    """Return workers that have none yet, with trials (scene, index) in their queue."""
    workers = LocalWorkers(2, start=None, run=None, output=None, builders=builders)
    workers._queue = deque(
        SimpleNamespace(
            trial=Trial(
                suite="s",
                suite_digest="0" * 64,
                suite_seed=1,
                scene=scene,
                scene_digest=scene,
                task="hurdles",
                index=index,
            )
        )
        for scene, index in trials
    )
    return workers


ROUNDS = [(scene, index) for index in (0, 1) for scene in "abc"]


def test_the_next_trial_is_the_first_one_whose_scene_is_built():
    assert queued(Held("a"), *ROUNDS)._next(None) == 1
    assert queued(Held("a", "b"), *ROUNDS)._next(None) == 2
    assert queued(Held(), *ROUNDS)._next(None) == 0


def test_a_core_builds_a_scene_before_it_runs_ahead_of_the_round():
    workers = queued(Held("b", "c"), *ROUNDS[1:])
    assert workers._next(None) == -1
    workers._build()
    assert (workers.builders.wanted, workers.builders.allowed) == (["b", "c"], 2)


def test_where_there_is_nothing_left_to_begin_a_core_runs_ahead_of_the_round():
    assert queued(Held("b", "c", has_more=False), *ROUNDS[1:])._next(None) == 2
    assert queued(Held("a", "b", "c", has_more=False), *ROUNDS)._next(None) == -1


def test_while_nothing_can_run_signals_are_heard():
    workers = queued(Held("c"), ("c", 0))
    workers.builders.repair = lambda: None
    finished = workers.finished()
    assert [next(finished) for _ in range(2)] == [None, None]
    assert not workers._busy


def test_a_scene_that_cannot_be_built_ends_the_run_and_blames_no_trial():
    def repair():
        raise SceneError("c: no such paint")

    workers = queued(Held("c"), ("c", 0))
    workers.builders.repair = repair
    with pytest.raises(SceneError, match="no such paint"):
        next(workers.finished())


def test_trials_that_draw_nothing_as_they_run_wait_for_no_scene():
    builders = Held("a", "b", "c")
    builders.on_demand = True
    workers = queued(builders, *ROUNDS)
    assert workers._next(None) == 0
    workers._build()
    assert not builders.wanted


def test_a_trial_that_waits_for_its_scene_lends_its_core_to_the_build():
    builders = Held("a", "b")
    builders.on_demand = True
    workers = queued(builders, ("c", 0))
    jobs = queued(None, ("b", 0), ("c", 1))._queue
    workers._busy = [
        SimpleNamespace(job=job, awaits_splat=waits, scenes=set())
        for job, waits in zip(jobs, (True, False), strict=True)
    ]
    workers._build()
    assert (builders.wanted, builders.allowed) == (["b"], 1)


SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 2
seed: 5
episode: {duration: 0.2}
scenes: [hurdles/one_low_carpet, hurdles/three_low]
record: RECORD
gate: {success_rate: 0.3}
"""


@pytest.mark.nightly
@pytest.mark.parametrize("record", ["all", "failures"])
def test_a_first_run_has_the_rows_and_the_logs_of_a_later_one(tmp_path, record):
    suite = tmp_path / "quick.yaml"
    suite.write_text(SUITE.replace("RECORD", record))
    runs = [tmp_path / name for name in ("first", "later")]
    for out in runs:
        api.run(str(suite), out=out, cache=False)
    rows, logs = zip(
        *(
            (
                rows_digest(read_journal(run / "journal.jsonl").rows),
                {log.name: log.read_bytes() for log in run.glob("mcap/**/*.mcap")},
            )
            for run in runs
        ),
        strict=True,
    )
    assert rows[0] == rows[1]
    assert logs[0] == logs[1]
    assert len(logs[0]) == 4
