"""What a class of machine is of nw-eval's own: the code that makes rows, and no other."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import nw_eval
from nw_eval.results import provenance
from nw_eval.results.provenance import JUDGING, code_info, rows_code_digest

PACKAGE = Path(nw_eval.__file__).parent


@pytest.fixture
def digests(tmp_path, monkeypatch):
    """Return a function of a file: the digests of rows and of all code once it has one more line.

    The digests are those of a copy of the package.
    """
    copy = tmp_path / "nw_eval"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "*.npz", "assets"))
    monkeypatch.setattr(provenance, "_PACKAGE", copy)

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
    ["reporting/headline.py", "gate/absolute.py", "cli/__init__.py", "api/__init__.py", "words.py"],
)
def test_a_report_may_be_worded_anew_on_the_same_class_of_machine(digests, name):
    rows, code = digests()
    assert (digests(name)[0], digests(name)[1] == code) == (rows, False)


@pytest.mark.parametrize(
    "name",
    [
        *("sim/world.py", "rollout/episode.py", "engine/rounds.py", "protocol.py"),
        *("robots/go1/robot.yaml", "robots/go2/robot.xml"),
    ],
)
def test_whatever_makes_rows_makes_another_class_of_machine(digests, name):
    assert digests()[0] != digests(name)[0]


_LOADED = """
import sys
import nw_eval.engine.session, nw_eval.engine.worker, nw_eval.rollout.trial
import nw_eval.rollout.observed, nw_eval.engine.workers
print(*sorted({name.split(".")[1] for name in sys.modules if name.startswith("nw_eval.")}))
"""


def test_only_rooms_count_for_nothing_that_name_things_keep_rows_or_judge_them():
    rooms = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert rooms >= JUDGING, "a room that is no more"
    done = subprocess.run(
        [sys.executable, "-c", _LOADED], capture_output=True, text=True, check=True
    )
    # What makes rows imports of them no more than how results are kept, and how things are called,
    # those of a hub too.
    assert JUDGING & set(done.stdout.split()) <= {
        "hub", "results", "request", "words", "errors", "clean", "plural", "amounts"
    }  # fmt: skip
