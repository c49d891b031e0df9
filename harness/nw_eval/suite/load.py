"""Suite files: finding, reading, and telling everything that is wrong with one at once.

That includes whether the scene names of a suite's tiers mean scenes that it runs. And writing them:
the resolved suite that runs and logs carry, and one for places without.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import StringIO
from math import ceil, prod
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, cast

from pydantic import ValidationError
from ruamel.yaml import YAML

from nw_base.errors import Problem, SuiteError, UsageError, nearest
from nw_base.files.cache import atomic_path, followed
from nw_base.files.inside import bounded_bytes, regular, what_is
from nw_base.files.shipped import available
from nw_base.files.yaml_file import YamlProblems, read_yaml, validation_problems
from nw_eval.suite.model import Source, Suite, new_suite
from nw_sim.rendering import DRAFTED

_LARGEST_MOTION = 2**30
"""Bytes, as of a card's files."""


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A suite file as far as it could be read, so that one fault does not hide another."""

    source: Source
    settings: Mapping[str, Any]
    """The file's settings, right or wrong."""
    problems: tuple[Problem, ...]
    """What is wrong with the file itself, in its order."""
    suite: Suite | None
    """The suite; None if there are problems."""

    @property
    def base(self) -> Path:
        """The folder that relative scene and policy paths of the file start from."""
        return self.source.base

    @property
    def scenes(self) -> dict[int, str]:
        """The entries of `scenes` that can be looked for, each once, by their place in the list."""
        listed = self.settings.get("scenes")
        entries = cast("Sequence[Any]", listed) if isinstance(listed, list | tuple) else ()
        found: dict[str, int] = {}
        for index, entry in enumerate(entries):
            if isinstance(entry, str) and entry:
                found.setdefault(entry, index)
        return {index: entry for entry, index in found.items()}

    @property
    def tiers(self) -> tuple[str, ...]:
        """The names and globs of `gate.tiers`."""
        gate = self.settings.get("gate")
        tiers = cast("dict[str, Any]", gate).get("tiers") if isinstance(gate, dict) else None
        return tuple(cast("dict[str, Any]", tiers)) if isinstance(tiers, dict) else ()

    def text(self, key: str) -> str | None:
        """Return a setting of the file, if it is text."""
        value = self.settings.get(key)
        return value if isinstance(value, str) and value else None


def draft_of(suite: Suite) -> Draft:
    """Return a suite that was read already as a draft without problems."""
    return Draft(
        source=suite.source, settings=suite.model_dump(by_alias=True), problems=(), suite=suite
    )


def draft_suite(name_or_path: str | Path, search: Path | None = None) -> Draft:
    """Read a suite by name or by path, with whatever is wrong with it.

    Args:
        name_or_path: `hurdles` is `suites/hurdles.yaml` of the project, or the shipped one;
            whatever has a slash or ends in `.yaml` is a path.
        search: the project's folder, by default the working directory.

    Raises:
        UsageError: there is no such suite; names the nearest one.
        SuiteError: the file is not a mapping of settings at all.
    """
    path = find_suite(name_or_path, search)
    problems: list[Problem] = []
    try:
        file = read_yaml(path)
    except YamlProblems as error:
        if error.file is None:
            raise SuiteError(error.problems) from None
        # A duplicate key must not hide that another value is wrong: look at what was read, too.
        problems, file = list(error.problems), error.file
    source = Source(file=file.path, places=file.places)
    suite: Suite | None = None
    try:
        suite = new_suite(file.data, source)
    except ValidationError as error:
        # What could not be read stands as None, which is no second fault.
        lines = {problem.line for problem in problems}
        more = validation_problems(error, file, Suite)
        problems += [p for p in more if not (p.line in lines and "None" in p.message)]
    if suite is not None:
        suite = _with_motion(suite, problems)
    return Draft(
        source=source,
        settings=file.data,
        problems=tuple(sorted(problems, key=lambda problem: (problem.line, problem.column))),
        suite=None if problems else suite,
    )


def _with_motion(suite: Suite, problems: list[Problem]) -> Suite:
    """Return a suite with the digest of the motion that its task names; add what is wrong."""
    if suite.motion is None:
        return suite
    named, place = cast("Any", suite.task).motion, ("task", "motion", "file")
    try:
        data = bounded_bytes(regular(suite.motion), _LARGEST_MOTION)
        found = hashlib.sha256(data).hexdigest()
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        why = (isinstance(error, OSError) and error.strerror) or error
        text = f"task.motion.file: the motion {named.file} cannot be read: {why}"
        fix = "check the path, which starts from the suite's folder"
        problems.append(suite.source.problem(place, text, fix))
        return suite
    if named.sha256 not in {None, found}:
        said = f"task.motion.sha256: the SHA-256 of {named.file} is {found}"
        fix = "get the right file, or correct `sha256` if this one is meant"
        problems.append(suite.source.problem((*place[:2], "sha256"), said, fix))
    motion = named.model_copy(update={"sha256": found})
    task = suite.task.model_copy(update={"motion": motion})
    return suite.model_copy(update={"task": task})


def load_suite(name_or_path: str | Path, search: Path | None = None) -> Suite:
    """Read a suite by name or by path, as `draft_suite` does.

    Raises:
        UsageError: there is no such suite; names the nearest one.
        SuiteError: the file has problems, all of them told, each with its line and column.
    """
    draft = draft_suite(name_or_path, search)
    if draft.suite is None:
        raise SuiteError(draft.problems)
    return draft.suite


def find_suite(name_or_path: str | Path, search: Path | None = None) -> Path:
    """Return the path of a suite file.

    Raises:
        UsageError: there is no such suite; names the nearest one.
    """
    name = str(name_or_path)
    known = available("suites", search)
    if name in known:
        return known[name]
    path = Path(name)
    if search is not None and not path.is_absolute():
        path = search / path
    kind = what_is(path)
    if kind == "file":
        return path
    if kind == "folder":
        raise UsageError(f"{name!r} is a folder, not a suite file", fix=nearest(name, known))
    try:
        regular(path)
    except OSError as error:
        raise UsageError(f"{name!r}: {error.strerror}", fix="name a suite file") from None
    raise UsageError(f"no suite {name!r}", fix=nearest(path.stem, known))


def tier_problems(draft: Draft, selected: Sequence[str], failed: Sequence[str]) -> list[Problem]:
    """Return a problem for each tier that names no scene of the suite, or decides for none.

    The first glob wins: one behind another that covers all of its scenes changes nothing.

    Args:
        draft: the suite, as far as it could be read.
        selected: names of the scenes that it runs, and of those it may mean where `failed`.
        failed: its entries that could not be opened. A tier that may be about one is left alone,
            for it would only echo that fault.
    """
    perhaps = [name for entry in failed for name in folder_names(entry)]
    unmeant = [
        draft.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: the suite runs no scene {pattern!r}",
            nearest(pattern, selected),
        )
        for pattern in draft.tiers
        if not any(fnmatchcase(name, pattern) for name in (*selected, *perhaps))
    ]
    return unmeant + [
        draft.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: {pattern!r} decides for no scene: {before!r} comes before it and is "
            "about all of its scenes",
            f"write {pattern!r} before {before!r}",
        )
        for pattern, before in _shadowed(draft.tiers, selected)
    ]


def _shadowed(tiers: Sequence[str], selected: Sequence[str]) -> list[tuple[str, str]]:
    """Return each glob whose scenes are all decided by globs before it, and one of these."""
    found: list[tuple[str, str]] = []
    for index, pattern in enumerate(tiers):
        scenes = [name for name in selected if fnmatchcase(name, pattern)]
        if pattern in scenes:
            continue  # An exact name wins, wherever it stands.
        winners = [
            next((before for before in tiers[:index] if fnmatchcase(name, before)), None)
            for name in scenes
            if name not in tiers
        ]
        if winners and winners[0] is not None and None not in winners:
            found.append((pattern, winners[0]))
    return found


def folder_names(entry: str) -> list[str]:
    """Return what the scene of a folder may be called: as the folder, or with the one around it."""
    parts = PurePosixPath(entry.rpartition(":")[2]).parts
    return ["/".join(parts[-count:]) for count in (1, 2)]


def suite_yaml(suite: Suite) -> str:
    """Return a suite as the text of a file that loads to an equal suite, defaults written out."""
    return _yaml(_plain(suite.model_dump(by_alias=True)), default_flow_style=False)


def _yaml(values: Any, *, default_flow_style: bool | None) -> str:
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = default_flow_style
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(values, stream)
    return stream.getvalue()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast("tuple[Any, ...]", value)]
    return value


_POLICIES: Mapping[str, str] = MappingProxyType(
    {"go1": "go1-parkour", "go2": "examples/himloco-go2"}
)
"""A policy of each robot that nw-eval has a card of and that needs no images."""
_ABOUT: Mapping[str, str] = MappingProxyType(
    {
        "go1": """\
# go1-parkour observes the ground under it and needs no camera: `--policy` runs another one.
""",
        "go2": """\
# himloco-go2 is blind. Its weights are not shipped, and `nw-eval check` prints where to get them:
# `--checkpoint` names them, `--policy` runs another one.
""",
    }
)


_HEAD = """\
# Keys: docs/reference/suite.md, and `nw-eval schema suite`.
"""


_LONGEST_NAME = 64
_FEWEST = 10  # trials in each scene


def robot_from(folder: Path, robot: str) -> str:
    """Return what names a robot in a suite of a folder, where its paths start.

    Args:
        folder: of the suite.
        robot: a name, or a path from the working directory.
    """
    if ":" in robot or "/" not in robot:
        return robot
    path = Path(os.path.relpath(robot, folder)).as_posix()
    return path if path.startswith("../") else f"./{path}"


def check_has_policy(robot: str) -> None:
    """Check that nw-eval knows a policy of a robot, which a suite without another one names.

    Raises:
        UsageError: it knows none.
    """
    if robot not in _POLICIES:
        raise UsageError(
            f"nw-eval has no policy of the robot {robot!r} to name in the scene's suite",
            fix="leave the robot out here, and then: nw-eval scenes check SCENE --robot ROBOT "
            "--policy POLICY --out FILE",
        )


def write_ready_suite(
    path: Path,
    name: str,
    scenes: Sequence[str],
    *,
    robot: str = "go1",
    policy: str | None = None,
    perturb: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> None:
    """Write a suite of scenes that `nw-eval run` takes as it is, whole or not at all.

    It has twice the trials that its bar needs of a policy that never fails, and 10 in each scene at
    least: a policy that fails now and then can pass, too.

    Args:
        path: of the file.
        name: of what it is about; what no suite's name may hold becomes a dash.
        scenes: as `scenes:` of a suite has them, one at least; paths start at the file.
        robot: that runs in it; a path starts at the file (`robot_from`).
        policy: as above, without `--policy` (default: one that nw-eval has a card of).
        perturb: values of axes of perturbation.

    Raises:
        UsageError: nw-eval has no policy of the robot, and none is named.
        StoreError: it cannot be written.
    """
    # What makes rows imports this file, and counts no statistics among its code.
    from nw_gate.stats.betting import trials_to_certify

    gate = {"success_rate": 0.75, "confidence": 0.95}
    cells = prod(len(values) for values in perturb.values())
    needed = ceil(trials_to_certify(gate["success_rate"], gate["confidence"]) / len(scenes) / cells)
    if policy is None:
        check_has_policy(robot)
    text: dict[str, Any] = {
        "nw-eval": 1,
        "name": suite_name(name),
        "robot": robot,
        "policy": policy or _POLICIES[robot],
        "trials": max(_FEWEST, 2 * needed),
        "seed": 1,
        "scenes": list(scenes),
        "render": DRAFTED.model_dump(),
        "record": "failures",
        "gate": gate,
    }
    if perturb:
        text["perturb"] = {axis: list(values) for axis, values in perturb.items()}
    head = _ABOUT.get(robot, "") if policy in {None, _POLICIES.get(robot)} else ""
    write_suite(path, text, head)


def write_suite(path: Path, settings: Mapping[str, Any], head: str = "") -> None:
    """Write the file of a suite, whole or not at all.

    Args:
        path: of the file.
        settings: what the file says.
        head: comments above it, each line with its end.

    Raises:
        StoreError: it cannot be written.
    """
    # None: a list of names on one line.
    content = head + _HEAD + _yaml(_plain(settings), default_flow_style=None)
    with atomic_path(followed(path)) as temporary:
        temporary.write_text(content, encoding="utf-8")


def suite_name(text: str) -> str:
    """Return a text as a suite may be called: what no name may hold becomes a dash."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text)[:_LONGEST_NAME]


def entry_from(folder: Path, reference: str, base: Path | None = None) -> str:
    """Return what names a scene, robot or policy in a suite of a folder, where its paths start.

    Args:
        folder: of the suite.
        reference: a name, or a path.
        base: folder that the path starts from; the working folder by default.
    """
    place = (Path() if base is None else base) / reference
    if not reference.startswith((".", "/")) and (":" in reference or not place.exists()):
        return reference
    return robot_from(folder, str(place))
