"""A worker that hangs is found within a minute; one that is slow, or on a busy machine, lives."""

import os
import signal
import subprocess
import sys
import time

import pytest

from nw_base.errors import PolicyError
from nw_eval.engine import worker
from nw_sim.rollout.confined import isolated, progress
from nw_sim.rollout.confined.progress import HANGS_AFTER, Progress

MINUTE, LIMIT = 60.0, 690.0
SPINS = "while True: pass"
COMPUTES = "import time; t = time.monotonic()\nwhile time.monotonic() - t < 1.0: pass"
HANGS = {
    "stopped policy": ("policy", "os.kill(os.getpid(), 19)", "a signal stopped"),
    "stopped world": ("sensor", "os.kill(os.getpid(), 19)", "a signal stopped"),
    "sleeping policy": ("policy", "import time; time.sleep(3600)", "used no processor time"),
    "sleeping world": ("sensor", "import time; time.sleep(3600)", "used no processor time"),
    "policy that loops": ("policy", f"exec({SPINS!r})", "no control step in"),
    "world that loops": ("sensor", f"exec({SPINS!r})", "no control step in"),
}
LOAD = 20


@pytest.fixture
def soon(monkeypatch):
    """Let a trial count as hung after some seconds; the real limit is tried at night."""
    for module in (worker, progress):
        monkeypatch.setattr(module, "HANGS_AFTER", 3.0)
    monkeypatch.setattr(worker, "_STEP", 1 / 1000)


@pytest.fixture
def busy_machine():
    """Twenty processes that loop beside the tests."""
    spinning = [subprocess.Popen([sys.executable, "-c", SPINS]) for _ in range(LOAD)]
    yield
    for process in spinning:
        process.kill()
        process.wait()


def ended(run):
    """Return the result of a run's only trial, and after how many seconds it came."""
    began = time.monotonic()
    with run.pool() as pool:
        pool.submit(run.jobs)
        [done] = [each for each in pool.finished() if each is not None]
    return done.result, time.monotonic() - began


def hung(tiny_run, kind):
    by, deed, why = HANGS[kind]
    run = tiny_run("hanger", deed=deed, by=by, trials=1, duration=30.0, time_limit=LIMIT)
    result, seconds = ended(run)
    assert (result.status, result.error_type) == ("error", "hung")
    assert why in result.error_text
    return seconds


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize("kind", HANGS)
def test_a_worker_that_hangs_is_found_long_before_the_time_limit(tiny_run, kind):
    assert hung(tiny_run, kind) < LIMIT / 3.0


@pytest.mark.nightly
@pytest.mark.parametrize("kind", HANGS)
def test_a_hung_worker_is_found_within_a_minute(tiny_run, kind):
    seconds = hung(tiny_run, kind)
    assert seconds > HANGS_AFTER - 3.0
    # A worker's start comes before. What loops has a core of its own, or it takes longer.
    has_core = os.getloadavg()[0] < os.cpu_count()
    assert seconds < MINUTE + 5.0 or ("loops" in kind and not has_core)


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize(
    "deed", ["import time; time.sleep(1.0)", f"exec({COMPUTES!r})"], ids=["waits", "computes"]
)
def test_a_slow_policy_that_comes_to_its_next_step_lives(tiny_run, deed):
    # Of ten steps, all but the first two are slow: longer together than one may be.
    deed = f"self.step -= 1; {deed}"
    result, seconds = ended(tiny_run("slow", deed=deed, trials=1, time_limit=94.0))
    assert result.status == "ok", result.error_text
    assert seconds > 5.0


@pytest.mark.nightly
@pytest.mark.usefixtures("soon", "busy_machine")
def test_a_policy_on_a_machine_with_a_load_of_twenty_lives(tiny_run):
    deed = "self.step -= 1; sum(range(5_000_000))"
    result, _ = ended(tiny_run("slow", deed=deed, trials=1, time_limit=94.0))
    assert result.status == "ok", result.error_text


@pytest.mark.usefixtures("soon")
def test_a_raised_time_limit_raises_what_a_step_may_take(tiny_run):
    deed = "sum(range(300_000_000))"  # Some six seconds, in one step.
    result, _ = ended(tiny_run("slow", deed=deed, trials=1, time_limit=1000 * 60.0))
    assert result.status == "ok", result.error_text


@pytest.mark.usefixtures("soon")
def test_processor_time_of_children_is_progress():
    program = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SPINS!r}])"
    parent = subprocess.Popen([sys.executable, "-c", program], start_new_session=True)
    try:
        seen = Progress(parent.pid)
        deadline = time.monotonic() + MINUTE
        while seen.busy() < 2.0 and time.monotonic() < deadline:
            time.sleep(0.2)
            assert not seen.look()
        assert seen.busy() >= 2.0
        assert seen.idle < 2.0
        subprocess.run(["pkill", "-STOP", "-s", str(parent.pid)], check=True)
        while not (why := seen.look()) and time.monotonic() < deadline:
            time.sleep(0.2)
        assert "a signal stopped its process" in why
    finally:
        subprocess.run(["pkill", "-KILL", "-s", str(parent.pid)], check=True)
        parent.wait()


@pytest.mark.usefixtures("soon")
def test_a_call_in_a_confined_process_that_does_nothing_is_given_up():
    began = time.monotonic()
    with pytest.raises(PolicyError, match="used no processor time for 3 s"):
        isolated.call_isolated(signal.pause, subject="a file", time_limit=600.0)
    assert time.monotonic() - began < MINUTE
