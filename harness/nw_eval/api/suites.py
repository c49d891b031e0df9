"""Suites: listed."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path
from textwrap import shorten

from nw_eval.clean import clean


def list_suites() -> str:
    """Return a table of the shipped and the project's suites, a line for each.

    Name, number of scenes and trials in each, bar, and the first sentence of the file's comment. A
    suite with problems is listed with the first of them.
    """
    from nw_eval.shipped import available

    found = available("suites")
    if not found:
        return "no suites: neither shipped, nor in ./suites"
    rows = [(name, *_describe(str(path))) for name, path in found.items()]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, (*widths, 0), strict=True)).rstrip()
        for row in rows
    )


def _describe(path: str) -> tuple[str, str, str]:
    """Return how much a suite runs, its bar, and what it is for."""
    from nw_eval.catalogue import names, open_scene, references
    from nw_eval.errors import NwEvalError
    from nw_eval.suite import load_suite

    try:
        suite = load_suite(path)
        scenes = references(suite.scenes, suite.base)
        for reference, collision in scenes:
            if reference not in names():  # A built-in one is right, and takes long to build.
                open_scene(reference, collision)
    except NwEvalError as error:
        return "?", "?", clean(str(error).splitlines()[0])
    bar = suite.gate.success_rate
    said = "no bar" if bar is None else f"bar {bar:g}"
    return f"{len(scenes)} scenes x {suite.trials}", said, _first_sentence(path)


def _first_sentence(path: str) -> str:
    """Return the first sentence of the comment that a file opens with, cut to a line."""
    lines = Path(path).read_text(encoding="utf-8").splitlines()
    comment = takewhile(lambda line: line.startswith("#"), lines)
    text = clean(" ".join(line.lstrip("# ") for line in comment))
    return shorten(text.split(". ", 1)[0].rstrip("."), width=90, placeholder=" ...")
