"""A protocol is a value of switches: each one difference, with a source, read somewhere."""

import ast
import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import get_args

import pytest

import nw_eval
from nw_base.protocol import NEVERWHERE_2026, PROTOCOLS, STRICT, EvaluationProtocol, protocol_named
from nw_base.words import Protocol

HARNESS = Path(nw_eval.__file__).parents[1]
OWN = HARNESS / "nw_base" / "protocol.py"
SWITCHES = [field.name for field in dataclasses.fields(EvaluationProtocol) if field.name != "name"]


def elsewhere() -> Iterator[tuple[Path, ast.Module]]:
    """Every production file but the protocols' own."""
    for path in sorted(HARNESS.rglob("*.py")):
        if path != OWN:
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def compared(tree: ast.AST) -> Iterator[str]:
    """The strings that a file compares something with."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare | ast.MatchValue):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.value


def test_every_word_has_its_protocol() -> None:
    assert list(PROTOCOLS) == list(get_args(Protocol))
    for word in get_args(Protocol):
        assert protocol_named(word).name == word


def test_nobody_else_asks_for_the_word() -> None:
    askers = {
        str(path.relative_to(HARNESS)): words
        for path, tree in elsewhere()
        if (words := set(compared(tree)) & set(get_args(Protocol)))
    }
    assert not askers


@pytest.mark.parametrize(
    "line",
    [
        'p == "strict"',
        '"strict" != p.name',
        'p in ("strict", "x")',
        'match p:\n case "strict": ...',
    ],
)
def test_a_comparison_is_recognised(line: str) -> None:
    assert "strict" in set(compared(ast.parse(line)))


@pytest.mark.parametrize("switch", SWITCHES)
def test_every_switch_is_one_difference(switch: str) -> None:
    one, other = getattr(STRICT, switch), getattr(NEVERWHERE_2026, switch)
    assert {one, other} == {True, False}


def test_every_switch_is_read_somewhere() -> None:
    read = {
        node.attr
        for _, tree in elsewhere()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
    }
    assert set(SWITCHES) <= read


def test_every_switch_names_its_source() -> None:
    (body,) = (
        node.body
        for node in ast.parse(OWN.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    )
    docstrings: dict[str, str] = {}
    for node, after in pairwise(body):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            assert isinstance(after, ast.Expr)
            assert isinstance(after.value, ast.Constant)
            docstrings[node.target.id] = str(after.value.value)
    assert list(docstrings) == ["name", *SWITCHES]
    assert [
        switch for switch in SWITCHES if "Source:" not in " ".join(docstrings[switch].split())
    ] == []
