"""The example of the page on other simulators prints what the page says."""

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "any-simulator.md"


def test_the_example_of_a_limit_prints_what_the_page_says():
    section = PAGE.read_text(encoding="utf-8").partition("## How far it can go\n")[2]
    (program,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (said,) = re.findall(r"```text\n(.*?)```", section, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stdout == said, done.stderr
