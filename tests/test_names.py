"""Names in the package say what they hold, and each class has its own."""

import ast
from collections import defaultdict
from pathlib import Path

import nw_eval

PACKAGE = Path(nw_eval.__file__).parent

MEANINGLESS = {"told", "said", "made", "given", "asked"}
"""Each of these was the name of a dozen different things."""

_VERB = "verbs of the command line are called as they are typed: `scenes check`"
_WRAPPER = "an entry of a card's `wrap`, and what it does to samples: two sides of one thing"
SHARED = {
    "Check": _VERB,
    "List": _VERB,
    "Render": _VERB,
    "Show": _VERB,
    "Verify": _VERB,
    "Channels": _WRAPPER,
    "Clip": _WRAPPER,
    "Crop": _WRAPPER,
    "Flatten": _WRAPPER,
    "Grayscale": _WRAPPER,
    "Normalize": _WRAPPER,
    "Quantize": _WRAPPER,
    "Resize": _WRAPPER,
    "Scale": _WRAPPER,
    "Stack": _WRAPPER,
}
"""Classes of one name, and why they may share it."""


def trees():
    """Yield each file of the package below its root, with its syntax tree."""
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE), ast.parse(path.read_text(encoding="utf-8"))


def names_of(node):
    """Return what a node of a syntax tree gives a name to."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            return [name]
        case ast.arg(arg=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
            return [name]
        case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)):
            return [name]
        case ast.MatchStar(name=str(name)) | ast.MatchMapping(rest=str(name)):
            return [name]
        case ast.alias(asname=str(name)):
            return [name]
        case _:
            return []


def test_nothing_is_named_for_how_it_came_about_in_place_of_what_it_is():
    found = {
        f"{path}:{node.lineno}: {name}"
        for path, tree in trees()
        for node in ast.walk(tree)
        for name in names_of(node)
        if name.strip("_") in MEANINGLESS
    }
    assert not found


def test_no_two_classes_have_one_name():
    places = defaultdict(list)
    for path, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path}:{node.lineno}")
    shared = {name: where for name, where in places.items() if len(where) > 1}
    assert shared.keys() == SHARED.keys(), shared
