"""docs/how-to/pytest.md names every option and every key of the ini file, and its tests run."""

import re
from pathlib import Path

import pytest

from nw_eval.pytest_plugin.options import add_options

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "pytest.md").read_text(encoding="utf-8")


def test_the_table_has_every_option_and_every_key():
    parser = pytest.Parser(_ispytest=True)
    add_options(parser)
    options = {name for group in parser._groups for each in group.options for name in each.names()}
    table = PAGE.split("## Options")[1].split("\n\n")[1]
    assert set(re.findall(r"`(--nw[\w-]+)`", table)) == options
    assert set(re.findall(r"`(nw_\w+)`", table)) == set(parser._inidict)
