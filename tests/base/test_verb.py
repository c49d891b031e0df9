"""A package brings commands; one whose table is broken is warned of, and costs no other."""

import sys
from importlib.metadata import EntryPoint

import pytest

from nw_base import verb
from nw_base.plugins import PluginWarning

BROUGHT = """\
from nw_base.verb import VerbTable

VERBS = VerbTable(
    table="""
TABLE = """
Evaluate:
  run Other page.md taken
Judge:
  tilt Tilt page.md say how far it tilted
    $ logs
  scenes
    bend Bend hall --by 2
"""


@pytest.fixture
def package(monkeypatch, tmp_path):
    """Return a function that lets the group name a module of these lines."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def name(module, text):
        (tmp_path / f"{module}.py").write_text(text)
        point = EntryPoint(name=module, value=f"{module}:VERBS", group=verb.GROUP)
        points = {module: (point,)}
        monkeypatch.setattr(verb, "installed", lambda _: points)
        monkeypatch.setattr("nw_base.plugins.installed", lambda _: points)
        return points

    yield name
    for module in ("tilting", "broken", "wrong"):
        sys.modules.pop(module, None)


def test_the_table_of_a_package_adds_verbs_and_parts_and_changes_none(package):
    package("tilting", f"{BROUGHT}{TABLE!r}, module='tilting.verbs')\n")
    groups = {}
    own = "Evaluate:\n  run Run page.md run it\n  scenes - page.md places\n    list List"
    verb.add_verbs(groups, own, "ours")
    (table,) = verb.declared()
    verb.add_verbs(groups, table.table, table.module)
    assert groups["Evaluate"]["run"].form == "Run"
    tilt = groups["Judge"]["tilt"]
    assert (tilt.form, tilt.module, tilt.examples) == ("Tilt", "tilting.verbs.tilt", ["logs"])
    parts = groups["Evaluate"]["scenes"].parts
    assert parts["list"].module == "ours.scenes"
    assert parts["bend"] == ("Bend", "hall --by 2", "tilting.verbs.scenes")


@pytest.mark.parametrize(
    ("module", "text", "said"),
    [
        ("broken", "raise RuntimeError('torn')", "cannot be imported: RuntimeError: torn"),
        ("wrong", "VERBS = 7", "is a int, no VerbTable"),
    ],
)
def test_a_package_whose_table_cannot_be_used_is_warned_of(package, module, text, said):
    package(module, text)
    with pytest.warns(PluginWarning, match=said):
        assert list(verb.declared()) == []
