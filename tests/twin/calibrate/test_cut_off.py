"""A calibration that was cut off leaves what it found, and goes on to the same bytes."""

import shutil
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from nw_twin.calibrate.calibrate import calibrate
from nw_twin.options import CalibrateOptions

QUICK = CalibrateOptions(features=400)


def files(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def few(photographed, tmp_path_factory):
    """A folder of four photographs that lie beside each other."""
    folder = tmp_path_factory.mktemp("few")
    for name in sorted(photographed.cameras)[4:8]:
        shutil.copy(photographed.folder / name, folder)
    return folder


@pytest.fixture(scope="module")
def whole(few, tmp_path_factory):
    """What comes of them without a break."""
    out = tmp_path_factory.mktemp("whole")
    calibrate(few, out, QUICK)
    return files(out)


@pytest.mark.parametrize(
    "at",
    [
        "features found",
        pytest.param("pairs compared", marks=pytest.mark.nightly),
        pytest.param("incremental mapping placed", marks=pytest.mark.nightly),
    ],
)
def test_what_was_found_is_kept_and_the_rest_comes_to_the_same_bytes(few, whole, tmp_path, at):
    def interrupted(line):
        lines.append(line)
        if line.startswith(at):
            raise KeyboardInterrupt

    lines = []
    with pytest.raises(KeyboardInterrupt):
        calibrate(few, tmp_path, QUICK, interrupted)
    assert [path.name for path in tmp_path.iterdir()] == [".calibrate.sqlite"]
    assert "the same command resumes" in lines[-1]
    lines.clear()
    calibrate(few, tmp_path, QUICK, lines.append)
    before = [line for line in lines if "before, by the calibration that was cut off" in line]
    names = ["features found", "pairs compared"][: 1 if at == "features found" else 2]
    assert [line.split(":")[0] for line in before] == names
    assert files(tmp_path) == whole


SIGNALLED = """
import builtins, os, sys
from nw_eval.cli import main

number, printed = int(sys.argv.pop(1)), builtins.print

def say(line, **how):
    printed(line, **how)
    if line.startswith("features found"):
        os.kill(os.getpid(), number)

builtins.print = say
main()
"""


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.nightly)]
)
def test_a_signal_ends_it_with_one_word_and_without_litter(few, tmp_path, number):
    scene = tmp_path / "scene"
    words = ["twin", "calibrate", str(few), "--out", str(scene), "--features", "400"]
    ended = subprocess.run(
        [sys.executable, "-c", SIGNALLED, str(int(number)), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 130
    assert ended.stderr == "interrupted\n"
    assert "is kept in" in ended.stdout
    capture = scene / "build" / "capture"
    # And what was known of the photographs before they were calibrated.
    assert sorted(path.name for path in capture.iterdir()) == [".calibrate.sqlite", "known.json"]


def test_what_a_killed_calibration_left_goes_with_the_next(few, whole, tmp_path):
    out = tmp_path / "out"
    (out / ".calibrate-dead" / "pictures").mkdir(parents=True)
    (tmp_path / "mine").write_bytes(b"of somebody")
    (out / ".calibrate.sqlite").symlink_to(tmp_path / "mine")
    calibrate(few, out, replace(QUICK, threads=2))
    assert files(out) == whole  # Nothing of theirs is left, nor do threads change a byte.
    assert (tmp_path / "mine").read_bytes() == b"of somebody"
