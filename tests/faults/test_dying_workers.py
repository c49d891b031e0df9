"""A worker that dies costs its trial; a parent that dies leaves no worker behind."""

import os
import signal
import time
from pathlib import Path

import pytest

from nw_base.errors import TrialError
from nw_gate.results.row import rows_digest


def test_a_killed_worker_costs_one_trial_which_is_then_run_again(tiny_run, tmp_path):
    # Who removes the token is killed: one worker, in the middle of its trial, however fast it is.
    token = tmp_path / "token"
    token.touch()
    removed = f"subprocess.run(['rm', {str(token)!r}], stderr=subprocess.DEVNULL).returncode == 0"
    deed = f"{removed} and os.kill(os.getpid(), 9)"
    run = tiny_run("victim", name="disturbed", deed=deed, by="sensor", trials=4)
    outcome = run.go(workers=2)
    assert not token.exists()
    assert [row.status for row in outcome.rows] == ["ok"] * 4
    assert sorted(row.attempt for row in outcome.rows) == [1, 1, 1, 2]
    [said] = [text for text in run.ears.messages if "crashed" in text]
    assert "SIGKILL" in said
    code = tmp_path / "policies" / "victim"
    undisturbed = tiny_run("victim", name="undisturbed", trials=4, code=code).go(workers=2)
    assert rows_digest(outcome.rows) == rows_digest(undisturbed.rows)


def test_no_worker_outlives_a_run(tiny_run, workers):
    tiny_run("fine", trials=2).go(workers=2)
    assert workers() == []


def test_workers_that_cannot_even_start_end_the_run_in_one_sentence(tiny_run, monkeypatch, workers):
    monkeypatch.setattr("nw_eval.engine.local.worker.start", os.abort)
    run = tiny_run("fine", trials=2)
    with pytest.raises(TrialError, match="before they could take a trial") as caught:
        run.go(workers=2)
    assert "\n" not in str(caught.value)
    assert workers() == []
    monkeypatch.undo()
    outcome = run.go(resume=True)
    assert [row.status for row in outcome.rows] == ["ok", "ok"]


def test_a_worker_waits_for_the_next_jobs_and_is_replaced_if_it_did_not_live_to_see_them(
    tiny_run, workers
):
    run = tiny_run("noter", deed="pass", trials=3)
    pids = []
    with run.pool() as pool:
        for job in run.jobs:
            pool.submit([job])
            [ended] = [each for each in pool.finished() if each is not None]
            assert ended.result.status == "ok"
            pids.append(sorted(workers()))
            if len(pids) == 2:
                for pid in pids[1]:
                    os.kill(pid, signal.SIGKILL)
    assert pids[0] == pids[1]
    assert set(pids[2]).isdisjoint(pids[1])
    assert [len(both) for both in pids] == [2, 2, 2], "a world and a policy"
    assert workers() == []


@pytest.mark.parametrize("by", ["policy", "sensor"])
@pytest.mark.parametrize("code", [0, 7])
def test_a_worker_that_ends_itself_is_noticed_whatever_its_code_says(tiny_run, code, by):
    # With the time limit as the only witness, code 0 would be told as `hung` after 60 s.
    run = tiny_run("leaver", deed=f"os._exit({code})", by=by, trials=1)
    with run.pool() as pool:
        pool.submit(run.jobs)
        [ended] = [each for each in pool.finished() if each is not None]
    assert ended.result.status == "error"
    assert (ended.result.error_type, ended.result.end_reason) == ("crashed", "exit")
    assert ended.result.error_text == f"the worker process ended with exit code {code}"


@pytest.mark.parametrize("by", ["policy", "sensor"])
def test_a_signal_is_told_from_an_exit(tiny_run, by):
    run = tiny_run("faller", deed="os.abort()", by=by, trials=1)
    with run.pool() as pool:
        pool.submit(run.jobs)
        [ended] = [each for each in pool.finished() if each is not None]
    assert (ended.result.error_type, ended.result.end_reason) == ("crashed", "")
    assert ended.result.error_text == "the worker process was killed by SIGABRT"


@pytest.mark.parametrize(
    "deed",
    [
        pytest.param("sys.exit(0)", id="exit"),
        pytest.param("raise KeyboardInterrupt", id="interrupt", marks=pytest.mark.nightly),
        pytest.param("raise GeneratorExit", id="generator", marks=pytest.mark.nightly),
        pytest.param("raise Odd(1, 2)", id="unpicklable"),
    ],
)
def test_nothing_that_a_policy_raises_ends_the_run(tiny_run, deed):
    outcome = tiny_run("raiser", deed=deed, trials=1).go(workers=1)
    assert outcome.missing == ()
    assert [row.completed for row in outcome.rows] == [False]
    assert all(row.error_type for row in outcome.rows)


def test_a_sensor_that_forks_speaks_with_one_voice(tiny_run):
    forking = tiny_run("forker", deed="os.fork()", by="sensor", trials=3).go(workers=1)
    still = tiny_run("stander", name="still", deed="pass", trials=3).go(workers=1)
    assert [row.status for row in forking.rows] == ["ok"] * 3
    assert [row.state_digest for row in forking.rows] == [row.state_digest for row in still.rows]


@pytest.mark.parametrize("session", [False, True], ids=["its session", "another session"])
def test_what_a_worker_started_ends_with_it(tiny_run, session):
    child = f"subprocess.Popen(['sleep', '600'], start_new_session={session})"
    deed = f"(self.folder / 'pid').write_text(str({child}.pid))"
    run = tiny_run("parent", deed=deed, by="sensor", trials=1)
    outcome = run.go(workers=1)
    assert [row.status for row in outcome.rows] == ["ok"]
    [noted] = Path(run.jobs[0].policy).parent.glob("pid")
    assert is_gone(int(noted.read_text()))


def test_what_a_worker_started_ends_too_if_the_worker_is_killed(tiny_run):
    child = "str(subprocess.Popen(['sleep', '600']).pid)"
    deed = f"(self.folder / 'pid').write_text({child}); os.kill(os.getpid(), 9)"
    run = tiny_run("parent", deed=deed, by="sensor", trials=1)
    with run.pool() as pool:
        pool.submit(run.jobs)
        [ended] = [each for each in pool.finished() if each is not None]
        assert "SIGKILL" in ended.result.error_text
        [noted] = Path(run.jobs[0].policy).parent.glob("pid")
        assert is_gone(int(noted.read_text()))


SPEAKERS = {
    "closes its line": "os.closerange(3, 64)",
    "talks nonsense": "[os.write(fd, b'n' * 100) for fd in pipes()]",
    "answers in its own way": "[os.write(fd, b'a' + bytes(13)) for fd in pipes()]",
}


@pytest.mark.parametrize("deed", SPEAKERS.values(), ids=SPEAKERS)
def test_a_policy_that_gives_no_answer_that_can_be_read_costs_its_trial(tiny_run, deed):
    run = tiny_run("speaker", deed=deed, trials=1)
    with run.pool() as pool:
        pool.submit(run.jobs)
        [ended] = [each for each in pool.finished() if each is not None]
    assert (ended.result.status, ended.result.error_type) == ("error", "crashed")
    assert "closed its pipe" in ended.result.error_text


def is_gone(pid):
    """Say whether a process ends; a zombie has ended."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False
