"""Random faults at random moments: the rows of an undisturbed run, true codes, nothing left."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
TALLY = HERE / "tally.md"  # Of the nightly test, as it was when something of it last changed.


def play(*words):
    done = subprocess.run(
        [sys.executable, str(HERE / "random_faults.py"), *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )
    print(done.stdout)
    return done.stderr if done.returncode else done.stdout


@pytest.mark.nightly
def test_fifteen_random_faults_change_nothing():
    assert "15 faults of seed 9, 0 not as they must be" in play(15, 9, "--fast", "--jobs", 2)


@pytest.mark.nightly
@pytest.mark.timeout(6 * 3600)
def test_two_hundred_random_faults_change_nothing():
    told = play(200, 15, "--jobs", 2, "--out", TALLY)
    assert "200 faults of seed 15, 0 not as they must be" in told


def test_the_tally_that_is_kept_is_of_every_kind_and_of_two_hundred_faults(monkeypatch):
    monkeypatch.syspath_prepend(HERE)
    from kinds import KINDS

    rows = re.findall(r"^\| ([^|]+) \| (\d+) \| (\d+) \|", TALLY.read_text(), re.MULTILINE)
    assert sum(int(times) for _, times, _ in rows) >= 200
    assert all(times == recovered for _, times, recovered in rows)
    assert {kind for kind, *_ in rows} == set(KINDS)
