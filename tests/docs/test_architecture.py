"""docs/concepts/architecture.md shows the packages as the contract of imports has them."""

import re
import tomllib
from pathlib import Path

import nw_eval
from nw_base import __version__

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text(encoding="utf-8")
HARNESS = Path(nw_eval.__file__).parents[1]


def contract():
    """Return the layers of the contract, from the top: which packages stand side by side."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    (found,) = (
        one for one in tool["importlinter"]["contracts"] if one["name"] == "Packages stack one way"
    )
    return [sorted(layer.split(" | ")) for layer in found["layers"]]


def test_its_lines_are_the_layers_of_the_contract():
    (drawn,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
    assert [sorted(line.split()) for line in drawn.splitlines()] == contract()


def test_every_folder_that_it_names_is_there():
    named = set(re.findall(r"`(nw_[a-z_/]+)/`", PAGE))
    assert len(named) > 15
    assert {name for name in named if not (HARNESS / name).is_dir()} == set()


def test_every_package_has_a_layer_and_a_line_of_the_table():
    layered = {name for layer in contract() for name in layer}
    folders = {path.name for path in HARNESS.iterdir() if path.is_dir()} - {"__pycache__"}
    assert folders == layered == set(re.findall(r"^\| `(nw_[a-z]+)` \|", PAGE, re.MULTILINE))


def test_the_wheels_of_the_table_are_those_that_hold_the_packages():
    table = dict(re.findall(r"^\| `(nw_[a-z]+)` \|.*\| `(nw-[a-z]+)` \|$", PAGE, re.MULTILINE))
    root = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    held = root["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert {name for name, wheel in table.items() if wheel == "nw-eval"} == {
        path.removeprefix("harness/") for path in held
    }
    for name in set(table) - {path.removeprefix("harness/") for path in held}:
        own = tomllib.loads((HARNESS / name / "pyproject.toml").read_text(encoding="utf-8"))
        assert table[name] == own["project"]["name"]


def test_wheels_name_each_other_by_their_one_version():
    files = [ROOT / "pyproject.toml", *HARNESS.glob("*/pyproject.toml")]
    assert len(files) == 6
    for file in files:
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
        extras = project.get("optional-dependencies", {}).values()
        needs = [need for group in (project["dependencies"], *extras) for need in group]
        ours = [need for need in needs if need.startswith("nw-")]
        assert all(need.endswith(f"=={__version__}") for need in ours), file
        assert ours or file.parent.name == "nw_base"


def test_the_map_of_contributing_has_every_package():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    packages = sorted(path.parent.name for path in ROOT.glob("harness/*/__init__.py"))
    assert sorted(re.findall(r"^\| `(nw_\w+)` \|", text, re.MULTILINE)) == packages
