"""Contacts with scans know how MuJoCo is laid out, and refuse one that is laid out otherwise."""

import ctypes
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest
from packaging.specifiers import SpecifierSet

from nw_base.errors import PrerequisiteError
from nw_scenes.narrowphase.install import _TYPES, TESTED, _check_records, check_layout

ROOT = Path(__file__).parents[3]
PLANE, BOX, CYLINDER = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("PLANE", "BOX", "CYLINDER")
)
LOOK = """
import mujoco
from nw_base.errors import NwEvalError
from nw_scenes.narrowphase.install import check_layout
try:
    check_layout()
except NwEvalError as error:
    print(type(error).__name__, error)
else:
    print("fine", mujoco.__version__)
"""


def test_the_tested_version_is_the_pinned_one_and_it_is_laid_out_as_known():
    pinned = re.search(r"^mujoco==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned[1] == TESTED
    (of_model, of_data), _ = check_layout()
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/><body><joint/><geom size='2'/></body></worldbody>"
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for owner, words in ((model, of_model), (data, of_data)):
        for name, word in words.items():
            array = getattr(owner, name)
            if array.size:
                found = ctypes.c_size_t.from_address(owner._address + 8 * word).value
                assert found == array.ctypes.data, name


def test_looking_changes_no_entry_of_the_table():
    _, table = check_layout()
    before = list(table)
    check_layout()
    assert list(table) == before


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (lambda _: 0, "has no collision function of a box on a plane"),
        (lambda table: table[PLANE * _TYPES + CYLINDER], "writes contacts in another form"),
    ],
    ids=["none", "another one"],
)
def test_a_table_that_does_not_hold_what_it_should_is_refused(entry, said):
    _, table = check_layout()
    words = np.array(table, dtype=np.uint64).tolist()
    words[PLANE * _TYPES + BOX] = entry(table)
    with pytest.raises(PrerequisiteError) as caught:
        _check_records(words)
    assert said in str(caught.value)
    assert f"MuJoCo {mujoco.__version__}" in str(caught.value)
    assert f"pip install 'mujoco=={TESTED}'" in str(caught.value)


def versions():
    """The versions of MuJoCo that pip finds, latest first."""
    ask = [sys.executable, "-m", "pip", "index", "versions", "mujoco"]
    said = subprocess.run(ask, capture_output=True, text=True, check=False)
    found = re.search(r"^Available versions: (.*)$", said.stdout, re.MULTILINE)
    return [] if found is None else found[1].split(", ")


def look(folder, version):
    """What the check says of a version, installed by pip into a folder of its own."""
    place = folder / version
    # Since 4.0 the library is a package of its own.
    parts = ("mujoco", "mujoco-core") if version >= "4" else ("mujoco",)
    pip = f"{sys.executable} -m pip install -q --no-deps --only-binary=:all: --target".split()
    wanted = [f"{part}=={version}" for part in parts]
    done = subprocess.run([*pip, str(place), *wanted], capture_output=True, check=False)
    if done.returncode != 0:
        return None
    looked = subprocess.run(
        [sys.executable, "-c", LOOK],
        env={"PYTHONPATH": str(place), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    return looked.stdout.strip() or looked.stderr


@pytest.mark.slow
@pytest.mark.nightly
def test_every_version_that_the_project_allows_is_laid_out_as_known(tmp_path):
    needs = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (allowed,) = (need.removeprefix("mujoco") for need in needs if need.startswith("mujoco"))
    found = [each for each in versions() if each in SpecifierSet(allowed)]
    if not found:
        pytest.skip("pip finds no version")
    said = {version: look(tmp_path, version) for version in found}
    assert any(said.values())
    assert all(words in {None, f"fine {version}"} for version, words in said.items()), said


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize(
    ("version", "said"),
    [
        # Its structures have other sizes; its records are the same.
        ("3.17.0", "fine 3.17.0"),
        # Its functions write mjContact, of 68 numbers.
        ("3.3.7", "PrerequisiteError MuJoCo 3.3.7 writes contacts in another form"),
    ],
)
def test_an_older_version_is_understood_or_refused(tmp_path, version, said):
    words = look(tmp_path, version)
    if words is None:
        pytest.skip(f"pip cannot install MuJoCo {version} here")
    assert words.startswith(said)
