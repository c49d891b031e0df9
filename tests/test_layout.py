"""Imports go one way, and no package grows unseen.

`python tests/test_layout.py [CHECKOUT]` prints the figures of all packages of a checkout.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

import nw_eval
from nw_base.public import homes

HARNESS = Path(nw_eval.__file__).parents[1]
ROOT = HARNESS.parent
_IMPORT = re.compile(r"^\s*(?:from|import) (nw_[\w.]*)(?: import ([^\n]*))?", re.MULTILINE)


def folder_imports(root):
    """Return which folders of packages each of them imports from, itself left out."""
    folders = {".".join(path.relative_to(root).parts) for path in root.rglob("*") if path.is_dir()}
    imports = defaultdict(set)
    for file in root.rglob("*.py"):
        here = ".".join(file.parent.relative_to(root).parts)
        for module, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
            inside = {f"{module}.{name.strip(' ()')}" for name in names.split(",")}
            for target in {module} | (inside & folders):
                imports[here].add(target if target in folders else target.rpartition(".")[0])
        imports[here].discard(here)
    return imports


def two_way(root):
    """Return the pairs of folders that import each other, functions included."""
    imports = folder_imports(root)
    return {
        (one, other)
        for one, others in imports.items()
        for other in others
        if one < other and one in imports[other]
    }


def test_no_two_folders_import_each_other():
    assert two_way(HARNESS) == set()


def test_a_pair_that_imports_each_other_is_found(tmp_path):
    package = tmp_path / "nw_eval"
    (package / "engine" / "cache").mkdir(parents=True)
    (package / "engine" / "plan.py").write_text("from nw_eval.engine.cache import key\n")
    (package / "engine" / "cache" / "key.py").write_text("")
    assert two_way(tmp_path) == set()
    (package / "engine" / "cache" / "key.py").write_text("import nw_eval.engine.plan\n")
    assert two_way(tmp_path) == {("nw_eval.engine", "nw_eval.engine.cache")}


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield the names that code imports, inside functions too, but not those for types alone."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        yield from imported(node)


def circle(root):
    """Return the names of files that import each other in a circle; none if there is no circle."""
    files = {}
    for path in root.rglob("*.py"):
        parts = path.relative_to(root).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    graph = {}
    for name, path in files.items():
        found = set(imported(ast.parse(path.read_text(encoding="utf-8"))))
        targets = {each if each in files else each.rpartition(".")[0] for each in found}
        graph[name] = (targets & files.keys()) - {name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_files_import_each_other_in_a_circle():
    assert circle(HARNESS) == []


def test_a_circle_that_is_closed_inside_a_function_is_found(tmp_path):
    package = tmp_path / "nw_eval"
    package.mkdir()
    (package / "plan.py").write_text("from nw_eval.order import draw\n")
    (package / "order.py").write_text("def draw():\n    pass\n")
    assert circle(tmp_path) == []
    (package / "order.py").write_text("def draw():\n    from nw_eval import plan\n")
    assert sorted(set(circle(tmp_path))) == ["nw_eval.order", "nw_eval.plan"]


class Figures(NamedTuple):
    """How large a package is, and who knows it."""

    lines: int
    names: int
    """That its `__init__.pyi` states."""
    importers: tuple[str, ...]
    """Packages that import from it."""


MOST = {
    "nw_base": Figures(
        5862,
        0,
        (
            "nw_eval",
            "nw_gate",
            "nw_learn",
            "nw_places",
            "nw_policies",
            "nw_scenes",
            "nw_sim",
            "nw_splat",
            "nw_twin",
        ),
    ),
    "nw_eval": Figures(
        37040,  # Limits: in the gate, of robots, in pages; suites that tell policies apart; ghosts.
        160,  # Limits; ladders and their rungs.
        ("nw_learn", "nw_twin"),
    ),
    "nw_gate": Figures(
        19500,  # Suites that tell policies apart; limits of ladders; bets made from the baseline.
        16,
        ("nw_eval", "nw_learn", "nw_sim", "nw_twin"),
    ),
    "nw_learn": Figures(
        6803,
        0,
        (),
    ),
    "nw_places": Figures(
        7800,  # Ladders: a dozen families of scenes with a number.
        0,
        ("nw_eval", "nw_learn", "nw_sim"),
    ),
    "nw_policies": Figures(
        27930,  # Targets; HumanoidVerse; motors as trained; code of trainings and of scripts.
        9,
        ("nw_eval", "nw_learn", "nw_sim"),
    ),
    "nw_scenes": Figures(
        14400,  # Robots are kept compiled; wheels are drafted.
        5,
        ("nw_eval", "nw_learn", "nw_places", "nw_policies", "nw_sim", "nw_twin"),
    ),
    "nw_sim": Figures(
        28500,  # Targets of joints and heights; motors as trained; bags as logs.
        0,
        ("nw_eval", "nw_learn", "nw_twin"),
    ),
    "nw_splat": Figures(
        6646,
        19,
        ("nw_eval", "nw_places", "nw_scenes", "nw_sim", "nw_twin"),
    ),
    "nw_twin": Figures(
        23950,  # USD stages and E57 in a confined process, splats alone, scale by one posterior.
        0,
        (),
    ),
}
"""What each package holds. A change that needs more says here what for, in the same commit."""
TESTS = 117400
"""Lines of all tests; 2,500 more for targets, motors, bags, COLLADA, drafts, up and floors."""
GROWTH = 1.02


def lines(folder):
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in folder.rglob("*.py"))


def figures(root):
    """Return the figures of the packages of a checkout, by name."""
    harness = root / "harness"
    packages = sorted(path.name for path in harness.iterdir() if (path / "__init__.py").is_file())
    known = {name: set() for name in packages}
    for name in packages:
        for file in (harness / name).rglob("*.py"):
            for module, _ in _IMPORT.findall(file.read_text(encoding="utf-8")):
                known.get(module.partition(".")[0], set()).add(name)
    return {
        name: Figures(
            lines=lines(harness / name),
            names=stated(harness / name / "__init__.pyi"),
            importers=tuple(sorted(known[name] - {name})),
        )
        for name in packages
    }


def stated(stub):
    """Return how many names a stub states."""
    return len(homes(str(stub))) if stub.is_file() else 0


@pytest.mark.parametrize("name", MOST)
def test_no_package_grows_unseen(name):
    found, most = figures(ROOT)[name], MOST[name]
    assert found.lines <= GROWTH * most.lines, "say in MOST what the lines are for"
    assert (found.names, found.importers) == (most.names, most.importers)


def test_every_package_has_its_figures_and_tests_have_theirs():
    assert MOST.keys() == figures(ROOT).keys()
    assert lines(ROOT / "tests") <= GROWTH * TESTS


def test_a_package_that_grows_is_found(tmp_path):
    package = tmp_path / "harness" / "nw_base"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("import nw_base.errors\n" * 50)
    stub = "from nw_base.errors import One as One, two as two\n"
    (package / "__init__.pyi").write_text(stub)
    assert figures(tmp_path) == {"nw_base": Figures(lines=50, names=2, importers=())}


def table(root):
    """Return the figures of a checkout as lines of text."""
    found = figures(root)
    rows = [
        f"{name:12} {each.lines:7,} {each.names:4}  {' '.join(each.importers) or '-'}"
        for name, each in found.items()
    ]
    total = sum(each.lines for each in found.values())
    return "\n".join(
        [*rows, f"{'harness':12} {total:7,}", f"{'tests':12} {lines(root / 'tests'):7,}"]
    )


if __name__ == "__main__":
    print(table(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT)))
