"""Packages that are installed for as long as a test runs, in this process and in its workers."""

import os
import sys
from contextlib import contextmanager

import pytest

from nw_base.plugins import installed
from nw_sim.rollout.confined import start

collect_ignore = ["packages"]  # Tests of packages run where these are installed.


@contextmanager
def _on_path(folder):
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(folder), before]))
    sys.path.insert(0, str(folder))
    installed.cache_clear()
    known = set(sys.modules)
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
        installed.cache_clear()
        for name in set(sys.modules) - known:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A function that installs a package: its name, its entry points by group, its module's text.

    What pip leaves is written: the module, and a folder with metadata and entry points. Trials run
    in this process; who draws their pages needs no package, and is forked from where none is.
    """
    monkeypatch.setattr(start, "_OURS", (*start._OURS, "PYTHONPATH"))
    site = tmp_path / "site"
    site.mkdir()

    def install(name, group, points, text=None, version="1.0"):
        info = site / f"{name}.dist-info"
        info.mkdir(exist_ok=True)
        lines = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        (info / "METADATA").write_text(lines)
        entries = "".join(f"{key} = {value}\n" for key, value in points.items())
        (info / "entry_points.txt").write_text(f"[{group}]\n{entries}")
        if text is not None:
            (site / f"{name}.py").write_text(text)
        installed.cache_clear()
        return site / f"{name}.py"

    with _on_path(site):
        yield install
