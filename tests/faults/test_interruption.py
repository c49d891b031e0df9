"""Ctrl-C, SIGTERM and kill -9: a run waits for no trial, and is resumed to the same rows."""

import os
import pickle  # noqa: TID251 - of our own objects, between our own processes.
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nw_gate.results.journal import read_journal
from nw_gate.results.row import rows_digest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import pickle, sys
from pathlib import Path
from tests.trial_runs import run_trials
from nw_eval.engine.local import LocalProcesses
from nw_gate.results.journal import Journal

if __name__ == "__main__":
    run = pickle.loads(Path(sys.argv[1]).read_bytes())
    with Journal.create(run["folder"].journal, run["header"]) as journal:
        outcome = run_trials(
            run["jobs"],
            journal=journal,
            folder=run["folder"],
            policy=run["policy"],
            start_workers=LocalProcesses(run["jobs"], run["folder"]),
            workers=2,
        )
    print(outcome.interrupted.name if outcome.interrupted else "whole", len(outcome.missing))
"""


# Of the trials that come to it, two end; the others last until the file `goes-on` is there.
LASTS = """
            import time
            for mark in ("one", "two"):
                try:
                    (self.folder / mark).mkdir()
                    break
                except FileExistsError:
                    pass
            else:
                while not (self.folder / "goes-on").exists():
                    time.sleep(0.01)
"""


@pytest.fixture
def lasting(tiny_run):
    """Return a run of six trials of which four do not end, however fast the machine is."""
    return tiny_run("lasts", deed=LASTS, by="sensor", name="cut", trials=6, time_limit=600.0)


def start(run, tmp_path):
    """Start a run in a process group of its own, as a terminal does."""
    script, pickled = tmp_path / "script.py", tmp_path / "run.pickle"
    script.write_text(SCRIPT)
    plain = {name: getattr(run, name) for name in ("folder", "jobs", "header", "policy")}
    pickled.write_bytes(pickle.dumps(plain))
    return subprocess.Popen(
        [sys.executable, str(script), str(pickled)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def wait_for_rows(run, count, process):
    deadline = time.monotonic() + 90.0
    while time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        path = run.folder.journal
        if path.exists() and path.read_bytes().count(b'{"row"') >= count:
            return
        time.sleep(0.02)
    pytest.fail("the run did not get going")


def members(group):
    """Return the processes of a group that are alive."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[2]) == group and fields[0] != "Z":
                found.append(int(entry.name))
    return found


def is_gone(group):
    deadline = time.monotonic() + 60.0
    while members(group) and time.monotonic() < deadline:
        time.sleep(0.05)
    return members(group) == []


@pytest.mark.parametrize(
    ("number", "to_group"),
    [
        pytest.param(signal.SIGINT, True, id="ctrl-c"),
        pytest.param(signal.SIGTERM, False, id="sigterm", marks=pytest.mark.nightly),
    ],
)
def test_an_interrupted_run_waits_for_no_trial_and_resumes_to_the_same_rows(
    lasting, tiny_run, tmp_path, number, to_group
):
    process = start(lasting, tmp_path)
    wait_for_rows(lasting, 2, process)
    if to_group:
        os.killpg(process.pid, number)  # A terminal's Ctrl-C reaches the workers too.
    else:
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert out.split() == [number.name, "4"]
    assert is_gone(process.pid)
    assert len(read_journal(lasting.folder.journal).rows) == 2
    policy = tmp_path / "policies" / "lasts"
    (policy / "goes-on").touch()
    outcome = lasting.go(resume=True)
    assert lasting.ears.already == 2
    assert len(lasting.ears.rows) == 4
    whole = tiny_run("lasts", code=policy, name="whole", trials=6).go()
    assert rows_digest(outcome.rows) == rows_digest(whole.rows)


def test_a_second_ctrl_c_ends_at_once_and_leaves_no_worker(lasting, tmp_path):
    process = start(lasting, tmp_path)
    wait_for_rows(lasting, 1, process)
    os.killpg(process.pid, signal.SIGINT)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert is_gone(process.pid)
    assert read_journal(lasting.folder.journal).rows


@pytest.mark.nightly
def test_workers_do_not_outlive_a_parent_that_is_killed(lasting, tmp_path):
    process = start(lasting, tmp_path)
    wait_for_rows(lasting, 1, process)
    process.kill()
    process.communicate(timeout=60)
    assert is_gone(process.pid)
    (tmp_path / "policies" / "lasts" / "goes-on").touch()
    outcome = lasting.go(resume=True)
    assert [row.status for row in outcome.rows] == ["ok"] * 6


def test_a_group_that_is_killed_leaves_nothing_in_shared_memory(lasting, tmp_path):
    # What a killed group leaves behind is what it has mapped by name while it lives.
    process = start(lasting, tmp_path)
    wait_for_rows(lasting, 2, process)
    family = [process.pid, *descendants(process.pid)]
    mapped = [line for pid in family for line in maps(pid) if "/dev/shm/" in line]
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    assert len(family) >= 3, "parent and two workers"
    assert mapped == []


def test_sigterm_ends_a_check_and_the_process_that_opens_its_policy(tiny_run, tmp_path):
    tiny_run("sleeper", deed="pass")
    folder = tmp_path / "policies" / "sleeper"
    (folder / "sleeper.py").write_text("import time; time.sleep(600)  # while it is imported\n")
    main = [sys.executable, "-c", "from nw_eval.cli import main; main()"]
    process = subprocess.Popen(
        [*main, "check", "smoke", "--policy", str(folder), "--allow-code"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline, opener = time.monotonic() + 60.0, None
    while opener is None and time.monotonic() < deadline:
        time.sleep(0.02)
        opener = next((pid for pid in descendants(process.pid) if is_asleep(pid)), None)
    assert opener is not None, "nobody opened the policy"
    process.terminate()
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "interrupted\n")
    assert not Path(f"/proc/{opener}").exists()


def is_asleep(pid):
    """Say whether a confined process is in clock_nanosleep, of x86_64 or aarch64."""
    try:
        where = Path(f"/proc/{pid}/syscall").read_text().split()[0]
        name = Path(f"/proc/{pid}/status").read_text()
    except (OSError, IndexError):
        return False
    return where in {"230", "115"} and "Seccomp:\t2" in name


def descendants(pid):
    """Return the processes that a process started, and those that they did."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [each for child in children for each in (int(child), *descendants(int(child)))]


def maps(pid):
    try:
        return Path(f"/proc/{pid}/maps").read_text().splitlines()
    except OSError:
        return []
