"""Scenes stay what they were, unless somebody means to change them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from nw_places.entry import GENERATOR_VERSION
from nw_sim.catalogue import names


def _golden():
    path = Path(__file__).parent / "golden" / "scenes.py"
    spec = importlib.util.spec_from_file_location("golden_scenes", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


golden = _golden()
RECORD = json.loads(golden.RECORD.read_text())
_HINT = "if this is meant, run `python tests/places/golden/scenes.py` and commit the record"


def test_the_record_names_every_scene():
    assert sorted(RECORD["geometry"]) == list(names()), _HINT


@pytest.mark.parametrize("name", names())
def test_geometry_and_trail_are_as_recorded(name):
    assert golden.geometry(name) == RECORD["geometry"].get(name), _HINT


def test_the_generators_version_is_raised_with_every_change_of_its_code():
    # Without it, caches would go on serving Gaussians that the code no longer makes.
    assert golden.source() == RECORD["source"], (
        "the code that makes Gaussians has changed: raise GENERATOR_VERSION in built_in/entry.py, "
        "then run `python tests/places/golden/scenes.py`"
    )
    assert RECORD["version"] == GENERATOR_VERSION, _HINT


def test_comments_docstrings_and_layout_do_not_count_as_changes_and_code_does():
    def shape(text):
        return golden._shape(golden.ast.parse(text))

    plain = shape("def f(x):\n    return x + 1\n")
    assert shape('def f(x):\n    """Say."""\n    # Why.\n    return (x\n        + 1)\n') == plain
    assert shape("def f(x):\n    return x + 2\n") != plain


def test_the_file_in_which_a_definition_stands_does_not_count_and_the_definition_does():
    one, two = "def f(x):\n    return x + 1\n", "from a import f\n\nSIZE = 3\n"
    apart = golden._digest_of_code([one, two])
    assert golden._digest_of_code([two + one]) == apart
    assert golden._digest_of_code([one, two.replace("3", "4")]) != apart
