"""A worker that dies costs its trial; a parent that dies leaves no worker behind."""

import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from nw_eval.errors import TrialError
from nw_eval.results.row import rows_digest


def kill_the_first_busy_worker(folder, killed):
    """Wait until a trial writes its log, then kill whoever writes it."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not killed:
        logs = list(folder.path.glob("mcap/**/*.partial"))
        for child in multiprocessing.active_children():
            try:
                opened = [fd.readlink() for fd in Path(f"/proc/{child.pid}/fd").iterdir()]
            except OSError:
                continue
            if any(log in opened for log in logs):
                os.kill(child.pid, signal.SIGKILL)
                killed.append(child.pid)
                return
        time.sleep(0.005)


def test_a_killed_worker_costs_one_trial_which_is_then_run_again(tiny_run):
    run = tiny_run("slow", name="disturbed", trials=4)
    killed = []
    killer = threading.Thread(target=kill_the_first_busy_worker, args=(run.folder, killed))
    killer.start()
    outcome = run.go(workers=2)
    killer.join()
    assert len(killed) == 1
    assert [row.status for row in outcome.rows] == ["ok"] * 4
    assert sorted(row.attempt for row in outcome.rows) == [1, 1, 1, 2]
    [said] = [text for text in run.ears.messages if "crashed" in text]
    assert "SIGKILL" in said
    undisturbed = tiny_run("slow", name="undisturbed", trials=4).go(workers=2)
    assert rows_digest(outcome.rows) == rows_digest(undisturbed.rows)


def test_no_worker_outlives_a_run(tiny_run):
    tiny_run("fine", trials=2).go(workers=2)
    assert multiprocessing.active_children() == []


def test_workers_that_cannot_even_start_end_the_run_in_one_sentence(tiny_run, monkeypatch):
    monkeypatch.setattr("nw_eval.engine.local.worker.start", os.abort)
    run = tiny_run("fine", trials=2)
    with pytest.raises(TrialError, match="before they could take a trial") as caught:
        run.go(workers=2)
    assert "\n" not in str(caught.value)
    assert multiprocessing.active_children() == []
    monkeypatch.undo()
    outcome = run.go(resume=True)
    assert [row.status for row in outcome.rows] == ["ok", "ok"]
