"""Suites: listed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from textwrap import shorten

from nw_eval.clean import clean


@dataclass(frozen=True, kw_only=True)
class ListedSuite:
    """A suite that can be asked for by name, as far as its file can be read."""

    name: str
    file: Path
    purpose: str = ""
    """The first sentence of the comment that the file opens with, cut to a line."""
    scenes: int = 0
    trials: int = 0
    """In each scene."""
    bar: float | None = None
    """The success rate to reach; None for a suite that only runs."""
    problem: str | None = None
    """The first of what is wrong with the file; then nothing else of it is known."""


def list_suites() -> tuple[ListedSuite, ...]:
    """Return the shipped suites and those of the project in the working directory, by name."""
    from nw_eval.files.shipped import available

    return tuple(_listed(name, path) for name, path in available("suites").items())


def _listed(name: str, path: Path) -> ListedSuite:
    from nw_eval.catalogue import names, open_scene, references
    from nw_eval.errors import NwEvalError
    from nw_eval.suite import load_suite

    try:
        suite = load_suite(str(path))
        scenes = references(suite.scenes, suite.base)
        for reference, collision in scenes:
            if reference not in names():  # A built-in one is right, and takes long to build.
                open_scene(reference, collision)
    except NwEvalError as error:
        return ListedSuite(name=name, file=path, problem=clean(str(error).splitlines()[0]))
    return ListedSuite(
        name=name,
        file=path,
        purpose=_first_sentence(path),
        scenes=len(scenes),
        trials=suite.trials,
        bar=suite.gate.success_rate,
    )


def _first_sentence(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = takewhile(lambda line: line.startswith("#"), lines)
    text = clean(" ".join(line.lstrip("# ") for line in comment))
    return shorten(text.split(". ", 1)[0].rstrip("."), width=90, placeholder=" ...")
