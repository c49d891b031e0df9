"""Each package has a README of one screen, with an example that runs and prints what it says."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import nw_eval

HARNESS = Path(nw_eval.__file__).parents[1]
READMES = sorted(HARNESS.glob("*/README.md"))


def test_each_wheel_of_a_package_alone_has_a_readme():
    wheels = {path.parent for path in HARNESS.glob("*/pyproject.toml")}
    assert {path.parent for path in READMES} == wheels


@pytest.mark.parametrize("readme", READMES, ids=lambda path: path.parent.name)
def test_the_example_of_a_readme_prints_what_it_says(readme, tmp_path):
    text = readme.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 50
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (said,) = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.stdout == said, done.stderr
