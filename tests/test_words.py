"""Each list of words stands in one place, so that no two of them can differ."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import nw_eval
from nw_eval import words

ROOT = Path(nw_eval.__file__).parent


def lists_of_words() -> dict[frozenset[object], list[str]]:
    """Where each `Literal` of several words stands, by its words."""
    found: dict[frozenset[object], list[str]] = defaultdict(list)
    for file in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "Literal":
                inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
                if len(inner) > 1:
                    chosen = frozenset(ast.unparse(element) for element in inner)
                    found[chosen].append(file.relative_to(ROOT).as_posix())
    return found


def test_the_vocabulary_stands_in_words_and_nowhere_else() -> None:
    stated = [files for files in lists_of_words().values() if "words.py" in files]
    assert len(stated) > 8
    assert [files for files in stated if files != ["words.py"]] == []


def test_every_word_has_a_sentence_that_says_what_it_means() -> None:
    body = ast.parse(Path(words.__file__).read_text("utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and "Literal" in ast.unparse(node):
            assert isinstance(after, ast.Expr), ast.unparse(node)
