"""Random faults at random moments: the rows of an undisturbed run, true codes, nothing left."""

import subprocess
import sys
from pathlib import Path

import pytest


def play(count, seed):
    script = Path(__file__).with_name("random_faults.py")
    done = subprocess.run(
        [sys.executable, str(script), str(count), str(seed)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert f"{count} faults, 0 not as they must be" in done.stdout, done.stdout + done.stderr
    print(done.stdout)


def test_a_few_random_faults_change_nothing():
    play(3, 9)


@pytest.mark.nightly
@pytest.mark.timeout(6 * 3600)
def test_two_hundred_random_faults_change_nothing():
    play(200, 9)
