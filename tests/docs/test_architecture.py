"""docs/concepts/architecture.md shows the packages as the contract of imports has them."""

import re
import tomllib
from pathlib import Path

import nw_eval

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text(encoding="utf-8")
PACKAGE = Path(nw_eval.__file__).parent


def contract():
    """Return the layers of the contract, from the top: which packages stand side by side."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    (found,) = (
        one for one in tool["importlinter"]["contracts"] if one["name"] == "Rooms stack one way"
    )
    return [sorted(layer.split(" | ")) for layer in found["layers"]]


def test_its_lines_are_the_layers_of_the_contract():
    (drawn,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
    assert [sorted(line.split()) for line in drawn.splitlines()] == contract()


def test_every_package_that_it_names_is_there():
    named = set(re.findall(r"`([a-z_]+)/`", PAGE))
    assert len(named) > 15
    assert {name for name in named if not (PACKAGE / name).is_dir()} == set()


def test_every_package_has_a_layer():
    layered = {name for layer in contract() for name in layer}
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders - {"data"} <= layered
