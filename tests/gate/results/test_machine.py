"""What a class of machine is of nw-eval's own: the code that makes rows, and no other."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import nw_eval
from nw_gate.results import provenance
from nw_gate.results.provenance import JUDGING, code_info, rows_code_digest

HARNESS = Path(nw_eval.__file__).parents[1]


@pytest.fixture
def digests(tmp_path, monkeypatch):
    """Return a function of a file: the digests of rows and of all code once it has one more line.

    The digests are those of a copy of the packages.
    """
    copy = tmp_path / "harness"
    shutil.copytree(HARNESS, copy, ignore=shutil.ignore_patterns("__pycache__", "*.npz", "assets"))
    monkeypatch.setattr(provenance, "_ROOT", copy)

    def with_a_line(name=None):
        if name is not None:
            with (copy / name).open("a") as file:
                file.write("# One more line.\n")
        rows_code_digest.cache_clear()
        code_info.cache_clear()
        return rows_code_digest(), code_info().digest

    yield with_a_line
    rows_code_digest.cache_clear()
    code_info.cache_clear()


@pytest.mark.parametrize(
    "name",
    [
        *("nw_eval/reporting/headline.py", "nw_eval/cli/__init__.py", "nw_eval/api/__init__.py"),
        *("nw_gate/absolute.py", "nw_gate/results/baseline.py", "nw_base/words.py"),
        *("nw_twin/place.py", "nw_scenes/hub/fetch.py"),
    ],
)
def test_a_report_may_be_worded_anew_on_the_same_class_of_machine(digests, name):
    rows, code = digests()
    assert (digests(name)[0], digests(name)[1] == code) == (rows, False)


@pytest.mark.parametrize(
    "name",
    [
        *("nw_sim/physics/world.py", "nw_sim/rollout/episode.py", "nw_eval/engine/rounds.py"),
        *("nw_base/protocol.py", "nw_base/trials.py", "nw_gate/scores/effort.py"),
        *("nw_scenes/robots/go1/robot.yaml", "nw_scenes/robots/go2/robot.xml"),
    ],
)
def test_whatever_makes_rows_makes_another_class_of_machine(digests, name):
    assert digests()[0] != digests(name)[0]


_LOADED = """
import sys
import nw_eval.engine.session, nw_eval.engine.worker, nw_sim.rollout.trial
import nw_sim.rollout.observed, nw_eval.engine.workers
print(*sorted({"/".join(name.split(".")[:2]) for name in sys.modules if name.startswith("nw_")}))
"""


def test_only_rooms_count_for_nothing_that_name_things_keep_rows_or_judge_them():
    rooms = {
        f"{path.parent.name}/{path.stem}"
        for path in HARNESS.glob("*/*")
        if path.suffix == ".py" or path.is_dir()
    }
    assert rooms | {path.name for path in HARNESS.iterdir()} >= JUDGING, "a room that is no more"
    done = subprocess.run(
        [sys.executable, "-c", _LOADED], capture_output=True, text=True, check=True
    )
    # What makes rows imports of them no more than how results are kept, and how things are called,
    # those of a hub too.
    assert JUDGING & set(done.stdout.split()) <= {
        *("nw_base/clean", "nw_base/errors", "nw_base/plural", "nw_base/public", "nw_base/words"),
        *("nw_gate/results", "nw_gate/settings", "nw_scenes/hub"),
    }
