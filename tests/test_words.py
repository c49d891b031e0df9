"""Each word of the vocabulary says what it means."""

from __future__ import annotations

import ast
from pathlib import Path

from nw_eval import words


def test_every_word_has_a_sentence_that_says_what_it_means() -> None:
    body = ast.parse(Path(words.__file__).read_text("utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and "Literal" in ast.unparse(node):
            assert isinstance(after, ast.Expr), ast.unparse(node)
