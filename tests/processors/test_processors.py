"""Places, pictures, readings and trials have the same bits on processors of other kinds.

Libraries are told to take the kernels of other processors, in processes of their own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nw_places.entries import ENTRIES

HERE = Path(__file__).parent
NO_AVX_512 = "X86_V4 AVX512_ICL AVX512_SPR"
MASKS = {
    # As on a Haswell or a Zen 3.
    "AVX2": {"NPY_DISABLE_CPU_FEATURES": NO_AVX_512, "OPENBLAS_CORETYPE": "Haswell"},
    "SSE4": {"NPY_DISABLE_CPU_FEATURES": f"X86_V3 {NO_AVX_512}", "OPENBLAS_CORETYPE": "Nehalem"},
    "AVX2 in kernels": {
        "NPY_DISABLE_CPU_FEATURES": NO_AVX_512,
        "OPENBLAS_CORETYPE": "Zen",
        "NUMBA_CPU_NAME": "znver3",
        "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c,+bmi,+bmi2",
    },
}
ALL = ("files", "sensors", "trials")


def digests(*wanted, mask=(), emulator=()):
    """Return what a process prints that sees another processor, by name."""
    done = subprocess.run(
        [*emulator, sys.executable, str(HERE / "digests.py"), *wanted],
        env={**os.environ, **dict(mask)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(line.rsplit(": ", 1) for line in done.stdout.splitlines())


def recorded():
    """Return the digests of the built-in scenes, by name; `digests.py NAME...` printed them."""
    lines = (HERE / "scenes.txt").read_text("utf-8").splitlines()
    return dict(line.rsplit(": ", 1) for line in lines)


def test_pictures_readings_and_trials_are_the_same_without_avx_512():
    native = digests(*ALL)
    assert len(native) > 30
    assert digests(*ALL, mask=MASKS["AVX2"]) == native


def test_every_built_in_scene_is_recorded():
    assert {what.partition(",")[0] for what in recorded()} == {entry.name for entry in ENTRIES}


def test_a_built_in_scene_is_made_as_it_was_recorded():
    name = "hurdles/one_low_carpet"
    found = digests(name, mask=MASKS["AVX2"])
    assert found.items() <= recorded().items(), "this machine makes other Gaussians"


@pytest.mark.nightly
@pytest.mark.parametrize("mask", ["SSE4", "AVX2 in kernels"])
def test_pictures_readings_and_trials_are_the_same_on_others(mask):
    assert digests(*ALL, mask=MASKS[mask]) == digests(*ALL)


@pytest.mark.nightly
@pytest.mark.parametrize("mask", ["AVX2", "SSE4"])
@pytest.mark.parametrize(
    "name", ["hurdles/one_low_carpet", "gaps/four_stones_park", "stairs/five_low_podium"]
)
def test_scenes_are_the_same_without_avx_512(name, mask):
    assert digests(name, mask=MASKS[mask]) == digests(name)


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("task", ["hurdles", "gaps", "ramps", "stairs", "open", "flat"])
def test_all_built_in_scenes_are_made_as_they_were_recorded(task):
    wanted = {what: text for what, text in recorded().items() if what.startswith(f"{task}/")}
    assert wanted
    names = sorted(what.partition(",")[0] for what in wanted)
    assert digests(*names) == wanted


EMULATED = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+sse4.2,+popcnt,+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+movbe,+f16c,+cx16",
    "MUJOCO_GL": "disable",
}
"""What both processors have that are emulated. Kernels are compiled for it before, by this one: the
emulator takes an hour for that, and minutes for running them."""


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("model", ["Haswell", "EPYC"])
@pytest.mark.skipif(shutil.which("qemu-x86_64") is None, reason="no qemu-x86_64 here")
def test_pictures_readings_and_trials_are_the_same_on_emulated_processors(model):
    native = digests(*ALL, "smoke")
    assert digests(*ALL, "smoke", mask=EMULATED) == native
    emulator = ("qemu-x86_64", "-cpu", model)
    assert digests(*ALL, "smoke", mask=EMULATED, emulator=emulator) == native
