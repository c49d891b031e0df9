"""Ctrl-C, SIGTERM and kill -9: a run stops promptly, and is resumed to the same rows."""

import os
import pickle  # noqa: TID251 - of our own objects, between our own processes.
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nw_eval.results.journal import read_journal
from nw_eval.results.row import rows_digest

SCRIPT = """
import pickle, sys
from pathlib import Path
from nw_eval.engine.rounds import run_trials
from nw_eval.engine.local import LocalProcesses
from nw_eval.results.journal import Journal

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


def wait_until_gone(group, seconds):
    deadline = time.monotonic() + seconds
    while members(group) and time.monotonic() < deadline:
        time.sleep(0.05)
    return members(group)


@pytest.mark.parametrize(
    ("number", "to_group"),
    [
        pytest.param(signal.SIGINT, True, id="ctrl-c"),
        # By day, the random faults send it, too.
        pytest.param(signal.SIGTERM, False, id="sigterm", marks=pytest.mark.nightly),
    ],
)
def test_an_interrupted_run_stops_promptly_and_resumes_to_the_same_rows(
    tiny_run, tmp_path, number, to_group
):
    run = tiny_run("slow", name="cut", trials=6)
    process = start(run, tmp_path)
    wait_for_rows(run, 2, process)
    began = time.monotonic()
    if to_group:
        os.killpg(process.pid, number)  # A terminal's Ctrl-C reaches the workers too.
    else:
        process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert time.monotonic() - began < 5.0
    assert process.returncode == 0, err
    assert "Traceback" not in err
    said, missing = out.split()
    assert said == number.name
    assert int(missing) > 0
    assert wait_until_gone(process.pid, 5.0) == []
    kept = read_journal(run.folder.journal).rows
    assert len(kept) == 6 - int(missing)
    outcome = run.go(resume=True)
    assert run.ears.already == len(kept)
    assert len(run.ears.rows) == int(missing)
    whole = tiny_run("slow", name="whole", trials=6).go()
    assert rows_digest(outcome.rows) == rows_digest(whole.rows)


def test_a_second_ctrl_c_ends_at_once_and_leaves_no_worker(tiny_run, tmp_path):
    run = tiny_run("slow", name="cut", trials=6)
    process = start(run, tmp_path)
    wait_for_rows(run, 1, process)
    os.killpg(process.pid, signal.SIGINT)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=20)
    assert wait_until_gone(process.pid, 5.0) == []
    assert read_journal(run.folder.journal).rows


@pytest.mark.nightly
def test_workers_do_not_outlive_a_parent_that_is_killed(tiny_run, tmp_path):
    run = tiny_run("slow", name="cut", trials=6)
    process = start(run, tmp_path)
    wait_for_rows(run, 1, process)
    process.kill()
    process.communicate(timeout=20)
    assert wait_until_gone(process.pid, 5.0) == []
    outcome = run.go(resume=True)
    assert [row.status for row in outcome.rows] == ["ok"] * 6


def test_a_group_that_is_killed_leaves_nothing_in_shared_memory(tiny_run, tmp_path):
    # What a killed group leaves behind is what it has mapped by name while it lives.
    process = start(run := tiny_run("slow", name="cut", trials=6), tmp_path)
    wait_for_rows(run, 1, process)
    family = [process.pid, *descendants(process.pid)]
    mapped = [line for pid in family for line in maps(pid) if "/dev/shm/" in line]
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=20)
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
    out, err = process.communicate(timeout=20)
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
