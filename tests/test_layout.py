"""Imports between a folder and its own sub-folders go one way."""

import re
from collections import defaultdict
from pathlib import Path

import nw_eval

PACKAGE = Path(nw_eval.__file__).parent
_IMPORT = re.compile(r"^\s*(?:from|import) (nw_eval[\w.]*)(?: import ([^\n]*))?", re.MULTILINE)


def folder_imports(package):
    """Return which folders each folder of a package imports from, itself left out."""
    folders = {
        ".".join(path.relative_to(package.parent).parts)
        for path in (package, *package.rglob("*"))
        if path.is_dir()
    }
    imports = defaultdict(set)
    for file in package.rglob("*.py"):
        here = ".".join(file.parent.relative_to(package.parent).parts)
        for module, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
            inside = {f"{module}.{name.strip(' ()')}" for name in names.split(",")}
            for target in {module} | (inside & folders):
                imports[here].add(target if target in folders else target.rpartition(".")[0])
        imports[here].discard(here)
    return imports


def two_way(package):
    """Return the sub-folders that import a folder above them which imports them."""
    imports = folder_imports(package)
    return {
        below
        for below, above in imports.items()
        for folder in above
        if folder != package.name and below.startswith(folder + ".") and below in imports[folder]
    }


def test_no_folder_and_sub_folder_import_each_other():
    assert two_way(PACKAGE) == set()


def test_a_pair_that_imports_each_other_is_found(tmp_path):
    package = tmp_path / "nw_eval"
    (package / "engine" / "cache").mkdir(parents=True)
    (package / "engine" / "plan.py").write_text("from nw_eval.engine.cache import key\n")
    (package / "engine" / "cache" / "key.py").write_text("")
    assert two_way(package) == set()
    (package / "engine" / "cache" / "key.py").write_text("import nw_eval.engine.plan\n")
    assert two_way(package) == {"nw_eval.engine.cache"}
