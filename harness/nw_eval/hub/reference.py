"""What people write of something that is fetched: `hub:org/name[@revision]`, `menagerie:NAME`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from nw_eval.clean import clean
from nw_eval.errors import NwEvalError, PolicyError, RobotError, SceneError

PREFIX = "hub:"
MENAGERIE = "menagerie:"

Kind = Literal["scene", "policy", "robot"]

MAIN = "main"
"""The revision that is meant where none is named."""

# The hub's own rule for names, less those that begin with a dot or a dash.
_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,95}"
_REFERENCE = re.compile(rf"hub:({_NAME}/{_NAME})(?:@([A-Za-z0-9_][A-Za-z0-9_./-]{{0,199}}))?")
_MENAGERIE = re.compile(rf"{MENAGERIE}([a-z0-9_]{{1,64}})(?:@([0-9a-f]{{40}}))?")
_COMMIT = re.compile(r"[0-9a-f]{40}")

_ERRORS: dict[Kind, type[NwEvalError]] = {
    "scene": SceneError,
    "policy": PolicyError,
    "robot": RobotError,
}

# `download.py` of ziyc/neverwhere, commit 5774a18: one zip for each scene, whose root is the
# scene's folder.
_PUBLISHED = "ziyc/neverwhere"


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A repository of a hub, or one archive in it, at a revision."""

    text: str
    """What people wrote."""
    kind: Kind
    repository: str
    """`org/name`. Scenes are repositories of data sets, policies and robots are of models."""
    revision: str = MAIN
    """A branch, a tag or a commit."""
    label: str
    """Name of the folder that it is kept in."""
    archive: str | None = None
    """The zip in the repository that holds the scene; None = the repository's files are it."""

    @property
    def name(self) -> str:
        """What names it, whatever its revision."""
        return self.text.partition("@")[0]

    @property
    def repository_type(self) -> Literal["dataset", "model"]:
        """What the hub calls its kind."""
        return "dataset" if self.kind == "scene" else "model"

    @property
    def is_of_menagerie(self) -> bool:
        """Whether it is a robot of MuJoCo Menagerie, which no hub has."""
        return self.text.startswith(MENAGERIE)

    @property
    def is_pinned(self) -> bool:
        """Whether it names a commit, which never means anything else."""
        return is_commit(self.revision)

    def error(self, message: str, fix: str) -> NwEvalError:
        """Return the error of its kind: a SceneError, a PolicyError or a RobotError."""
        return _ERRORS[self.kind](f"{self.text}: {message}", fix=fix)


def is_commit(revision: str) -> bool:
    """Whether a revision is a commit in full: 40 hexadecimal digits."""
    return _COMMIT.fullmatch(revision) is not None


def parse(text: str, kind: Kind) -> Reference:
    """Return what `hub:org/name[@revision]` names, or of robots `menagerie:NAME[@revision]`.

    Raises:
        SceneError, PolicyError, RobotError: by its kind: it is no such reference.
    """
    if kind == "robot" and text.startswith(MENAGERIE):
        return _robot_of_menagerie(text)
    found = _REFERENCE.fullmatch(text)
    if found is None or ".." in text or "--" in found[1]:
        raise _ERRORS[kind](
            f"{clean(text, at_most=100)!r} names nothing on a hub",
            fix="write hub:org/name, or hub:org/name@revision",
        )
    repository, revision = found[1], found[2] or MAIN
    return Reference(
        text=text,
        kind=kind,
        repository=repository,
        revision=revision,
        label=repository.partition("/")[2],
    )


def _robot_of_menagerie(text: str) -> Reference:
    found = _MENAGERIE.fullmatch(text)
    if found is None:
        raise RobotError(
            f"{clean(text, at_most=100)!r} names no robot of MuJoCo Menagerie",
            fix="write menagerie:NAME, such as menagerie:unitree_go1",
        )
    return Reference(
        text=text,
        kind="robot",
        repository=f"menagerie/{found[1]}",
        revision=found[2] or MAIN,
        label=found[1],
    )


def published(name: str) -> Reference:
    """Return where the release of the Neverwhere benchmark has one of its scenes.

    Args:
        name: as the release's table of scenes spells it.
    """
    return Reference(
        text=f"neverwhere:{name}",
        kind="scene",
        repository=_PUBLISHED,
        label=name,
        archive=f"scenes/{name}.zip",
    )
