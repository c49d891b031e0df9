"""Machine code of kernels in the cache: private, checked, and never needed.

Each test runs programs of one small kernel, in a cache of their own.
"""

from __future__ import annotations

import os
import pickle  # noqa: TID251 - what an attacker would use.
import subprocess
import sys

import numpy as np
import pytest

PROGRAM = """\
import os, resource
from nw_base import machine_code as kept
from nw_base.machine_code import kernel

if "LIMITED" in os.environ:
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

@kernel
def add(a, b):
    return a + 2 * b

print(add(1, 3), add(1.5, 2.0))
stats = add.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
print(kept.folder_note())
"""


@pytest.fixture
def run(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)

    def go(**env):
        own = {"NW_EVAL_CACHE": str(tmp_path / "cache"), **env}
        done = subprocess.run(
            [sys.executable, program],
            env={name: text for name, text in os.environ.items() if name != "NW_EVAL_KERNELS"}
            | own,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        answer, counts, note = done.stdout.splitlines()
        assert answer == "7 5.5"
        hits, misses = map(int, counts.split())
        return hits, misses, note

    return go


@pytest.fixture
def kept(run, tmp_path):
    assert run() == (0, 2, "None")
    return sorted((tmp_path / "cache" / "kernels").iterdir())


def test_code_is_kept_in_a_private_folder_and_found_again(run, kept):
    assert len(kept) == 2
    assert kept[0].parent.stat().st_mode & 0o777 == 0o700
    assert run() == (2, 0, "None")


@pytest.mark.nightly
def test_a_damaged_file_is_compiled_again_and_the_next_process_finds_it(run, kept):
    first, second = kept
    whole = {path: path.read_bytes() for path in kept}
    rng = np.random.default_rng(1)
    for round_ in range(3):
        flipped = bytearray(whole[first])
        flipped[rng.integers(len(flipped))] ^= 1 << int(rng.integers(8))
        first.write_bytes(flipped)
        second.write_bytes(whole[second][: rng.integers(len(whole[second]))] if round_ else b"")
        assert run() == (0, 2, "None")
    assert run() == (2, 0, "None")
    assert sorted(first.parent.iterdir()) == kept


def test_a_file_that_another_wrote_is_never_unpickled(run, kept, tmp_path):
    class Poison:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "poisoned"),)

    for path in kept:
        path.write_bytes(pickle.dumps(Poison()))
    assert run() == (0, 2, "None")
    assert not (tmp_path / "poisoned").exists()


def test_a_rightly_sealed_file_of_another_kernel_is_not_used(run, kept):
    first, second = kept
    first.write_bytes(second.read_bytes())
    assert run() == (1, 1, "None")


def test_a_folder_that_others_may_write_is_not_used_and_that_is_said(run, kept):
    kept[0].parent.chmod(0o777)
    hits, misses, note = run()
    assert (hits, misses) == (0, 2)
    assert note.startswith("kernels are compiled for this run only: the cache folder ")
    assert "kernels may be written by others; remove it, or set NW_EVAL_CACHE" in note


@pytest.mark.nightly
def test_workers_use_the_folder_that_the_first_process_lends(run, kept, tmp_path):
    kept[0].parent.chmod(0o777)
    lent = tmp_path / "lent"
    lent.mkdir(mode=0o700)
    assert run(NW_EVAL_KERNELS=str(lent))[:2] == (0, 2)
    assert run(NW_EVAL_KERNELS=str(lent))[:2] == (2, 0)
    lent.chmod(0o777)
    hits, misses, note = run(NW_EVAL_KERNELS=str(lent))
    assert (hits, misses) == (0, 2)
    assert note.startswith("kernels are compiled in every process: ")


def test_a_process_that_has_no_folder_compiles_in_memory(run, tmp_path):
    (tmp_path / "file").touch()
    nowhere = str(tmp_path / "file" / "cache")
    hits, misses, note = run(NW_EVAL_CACHE=nowhere, NW_EVAL_KERNELS=nowhere)
    assert (hits, misses) == (0, 2)
    assert note.startswith("kernels are compiled in every process: cannot write ")


@pytest.mark.nightly
def test_a_process_that_cannot_write_compiles_in_memory_and_leaves_nothing(run, tmp_path):
    assert run(LIMITED="1") == (0, 2, "None")
    assert list((tmp_path / "cache" / "kernels").iterdir()) == []
    assert run() == (0, 2, "None")
    assert run(LIMITED="1") == (2, 0, "None")
