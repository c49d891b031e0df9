"""docs/how-to/python.md does what it says, and docs/reference/api.md has every function.

Every block runs as it stands, each in a fresh interpreter.
"""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nw_eval
from nw_eval import api

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "how-to" / "python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
REFERENCE = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
TABLE = REFERENCE.split("\n## All functions")[1]


def run_block(text, folder):
    """Run a block as a script without any guard round it, and return what it printed."""
    (folder / "block.py").write_text(text, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "block.py"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Return what the blocks printed that follow each other in one folder."""
    folder = tmp_path_factory.mktemp("reader")
    for name, text in re.findall(r"^```yaml (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL):
        (folder / name).parent.mkdir()
        (folder / name).write_text(text, encoding="utf-8")
    return [run_block(block, folder) for block in BLOCKS]


@pytest.mark.slow
@pytest.mark.nightly
def test_a_checkpoint_is_evaluated_in_five_lines(printed):
    assert len([line for line in BLOCKS[0].splitlines() if line]) == 5
    assert re.fullmatch(r"RAN [01]\.\d+\n", printed[0])


@pytest.mark.slow
def test_an_object_runs_without_a_file_and_its_rows_say_what_its_caller_calls_it(printed):
    lines = printed[1].splitlines()
    scenes = [line.split()[0] for line in lines]
    assert sorted(scenes) == sorted(2 * ["hurdles/one_low_carpet", "hurdles/three_low"])
    assert all(line.endswith(" step 1000") for line in lines)


@pytest.mark.slow
def test_rows_are_a_table_and_two_runs_pair_start_by_start(printed):
    assert "hurdles-one_low_carpet-000" in printed[2]
    assert "a RAN" in printed[3]
    assert "b RAN" in printed[3]
    assert re.search(r"^hurdles/three_low .* 2$", printed[3], re.MULTILINE)
    # Two starts in each of two scenes decide no rank.
    assert len(re.findall(r"^\S.* [01]\.\d+ 1 2$", printed[4], re.MULTILINE)) == 2


def test_every_function_has_its_line_and_what_it_returns_is_public():
    verbs = {name for name in api.__all__ if inspect.isfunction(getattr(api, name))}
    assert set(re.findall(r"`(\w+)\(", TABLE)) == verbs
    values = set(re.findall(r"`([A-Z]\w+)`", TABLE)) - {"DataFrame"}
    assert values <= set(nw_eval.__all__)
