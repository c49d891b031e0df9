"""Suites: listed, and shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from textwrap import shorten

from nw_base.clean import clean


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
    policy: str = ""
    """Its own policy, as the file names it."""
    baseline: str | None = None
    """The baseline that its own policy is compared with."""
    problem: str | None = None
    """The first of what is wrong with the file; then nothing else of it is known."""


def list_suites() -> tuple[ListedSuite, ...]:
    """Return the shipped suites and those of the project in the working directory, by name."""
    from nw_base.files.shipped import available

    return tuple(_listed(name, path) for name, path in available("suites").items())


@dataclass(frozen=True, kw_only=True)
class ShownSuite:
    """What a suite's file runs, and on which of its lines, from 1, that stands."""

    name: str
    file: str
    """As it was asked for."""
    scenes: Mapping[str, int]
    """The line that names a scene, by the scene's name; in the order in which they are run."""
    ladders: Mapping[str, int]
    """The line that names a ladder of the gate, by the ladder's name."""
    gate: int
    """The line of the gate; of the first setting where there is none."""
    baseline: str | None
    """The baseline that it names."""


def show_suite(suite: str | Path) -> ShownSuite:
    """Return what a suite's file runs, without looking at its policy.

    Args:
        suite: a file, or the name of a shipped suite.

    Raises:
        UsageError: there is no such suite.
        SuiteError: what is wrong with the file and its scenes, all of it.
    """
    from nw_eval.api.plans import Faults, open_scenes
    from nw_eval.suite import draft_suite
    from nw_sim.catalogue import open_scene, references

    draft = draft_suite(suite)
    faults = Faults(draft)
    open_scenes(draft, faults, None)
    faults.raise_any()
    assert draft.suite is not None, "a suite that cannot be used has faults"
    places = draft.source.places
    scenes: dict[str, int] = {}
    for index, pattern in draft.scenes.items():
        for each in references([pattern], draft.base):
            scenes.setdefault(open_scene(*each).name, places["scenes", index][0])
    return ShownSuite(
        name=draft.suite.name,
        file=draft.source.file,
        ladders={name: places["gate", "limits", name][0] for name in draft.suite.gate.limits},
        scenes=scenes,
        gate=places.get(("gate",), (1, 1))[0],
        baseline=draft.suite.gate.baseline,
    )


def _listed(name: str, path: Path) -> ListedSuite:
    from nw_base.errors import NwEvalError
    from nw_eval.suite import load_suite
    from nw_sim.catalogue import is_built_in, open_scene, references

    try:
        suite = load_suite(str(path))
        scenes = references(suite.scenes, suite.base)
        for reference, collision in scenes:
            if not is_built_in(reference):  # A built-in one is right, and takes long to build.
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
        policy=suite.policy,
        baseline=None if suite.gate.baseline == "none" else suite.gate.baseline,
    )


def _first_sentence(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = takewhile(lambda line: line.startswith("#"), lines)
    text = clean(" ".join(line.lstrip("# ") for line in comment))
    return shorten(text.split(". ", 1)[0].rstrip("."), width=62, placeholder=" ...")
