"""Mutated files of every kind: accepted whole or refused in one line, and nothing else happens.

Some seconds of seeded inputs run here; NW_EVAL_FUZZ multiplies them, `tally.py` counts
them by the ten thousand, and the nightly workflow draws new ones. What was found once lies in
`cases/`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
# About as many as a reader gets through in two seconds; a quarter of them runs here.
INPUTS = {
    "suite": 30, "card": 40, "onnx": 40, "tensors": 75,
    "inspect": 40, "scene": 12, "published": 30, "mesh": 60, "splat": 50, "cameras": 50,
    "store": 75, "journal": 75, "parquet": 50, "baseline": 50, "run": 40, "mcap": 30, "remote": 50,
    "elevation": 60, "robot": 30, "robot log": 40,
}  # fmt: skip
FACTOR = float(os.environ.get("NW_EVAL_FUZZ", "0.25"))
SEED = os.environ.get("NW_EVAL_FUZZ_SEED", "20261122")


def fuzz(*arguments):
    """Run the arena in a process of its own, where forking is safe; return its tally."""
    done = subprocess.run(
        [sys.executable, str(HERE / "arena.py"), *arguments],
        capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.timeout(0)
@pytest.mark.parametrize(
    "target",
    [
        pytest.param(target, marks=() if number % 2 == 0 else pytest.mark.nightly)
        for number, target in enumerate(INPUTS)
    ],
)
def test_mutated_files_are_read_whole_or_refused_in_words(target, tmp_path):
    count = max(1, int(INPUTS[target] * FACTOR))
    tally = fuzz(target, "--inputs", str(count), "--seed", SEED, "--keep", str(tmp_path))
    assert tally["findings"] == []
    assert tally["inputs"] == count
    assert tally["refused"] > 0


@pytest.mark.parametrize("target", sorted({path.parent.name for path in HERE.glob("cases/*/*")}))
def test_what_was_found_once_is_not_found_again(target):
    tally = fuzz(target, "--cases", str(HERE / "cases" / target))
    assert tally["findings"] == []
    assert tally["inputs"] > 0
