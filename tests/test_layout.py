"""Imports go one way: between a folder and its own sub-folders, and among all files."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import nw_eval

HARNESS = Path(nw_eval.__file__).parents[1]
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
