"""What people write of something that is fetched: `hub:org/name[@revision]`, `menagerie:NAME`.

What has been fetched: where it lies, which revision it is, and that it is still what came.

    <cache>/hub/<kind>/<org>/<name>/<commit>/<label>/         the files
                                            <label>.json      what they are: a `Fetched`
                                   <label>.revisions.json     which commit a branch or tag meant

`kind` is scene, policy or robot, and `label` the name of the folder that people see: the
repository's, or of a published scene its own. A folder and its list appear together or not at all.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, Literal, cast

from nw_base.clean import clean
from nw_base.errors import NwEvalError, PolicyError, RobotError, SceneError, StoreError
from nw_base.files.cache import atomic_path, cache_dir
from nw_base.files.inside import OutsideError, inside
from nw_scenes.hub import limits

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
    match = _REFERENCE.fullmatch(text)
    if match is None or ".." in text or "--" in match[1]:
        raise _ERRORS[kind](
            f"{clean(text, at_most=100)!r} names nothing on a hub",
            fix="write hub:org/name, or hub:org/name@revision",
        )
    repository, revision = match[1], match[2] or MAIN
    return Reference(
        text=text,
        kind=kind,
        repository=repository,
        revision=revision,
        label=repository.partition("/")[2],
    )


def _robot_of_menagerie(text: str) -> Reference:
    match = _MENAGERIE.fullmatch(text)
    if match is None:
        raise RobotError(
            f"{clean(text, at_most=100)!r} names no robot of MuJoCo Menagerie",
            fix="write menagerie:NAME, such as menagerie:unitree_go1",
        )
    return Reference(
        text=text,
        kind="robot",
        repository=f"menagerie/{match[1]}",
        revision=match[2] or MAIN,
        label=match[1],
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


_ROOM = "hub"


@dataclass(frozen=True, kw_only=True)
class Fetched:
    """A scene, a policy or a robot that was fetched."""

    reference: str
    """What names it, without a revision."""
    kind: Kind
    repository: str
    revision: str
    """The commit, 40 hexadecimal digits."""
    endpoint: str
    """The hub that it came from."""
    fetched: str
    """When: UTC in ISO 8601."""
    folder: Path
    files: Mapping[str, str]
    """Hex SHA-256 of each, by name in the folder."""
    bytes: int
    """Of all files together."""

    def __str__(self) -> str:
        day = self.fetched.partition("T")[0]
        return f"{self.reference} is revision {self.revision[:12]}, fetched {day}"


def repository_folder(reference: Reference) -> Path:
    """Return (and create) the folder of everything that was fetched of a repository.

    Raises:
        StoreError: it cannot be made.
    """
    return cache_dir(_ROOM, reference.kind, *reference.repository.split("/"))


def known_commit(reference: Reference) -> str | None:
    """Return which commit a reference meant when it was last fetched; None if it never was."""
    if reference.is_pinned:
        return reference.revision
    commit = _revisions(reference).get(reference.revision)
    return commit if isinstance(commit, str) and is_commit(commit) else None


def remember_commit(reference: Reference, commit: str) -> None:
    """Keep which commit a reference means from now on.

    Raises:
        StoreError: it cannot be written.
    """
    known = _revisions(reference) | {reference.revision: commit}
    with atomic_path(_revisions_file(reference)) as temporary:
        temporary.write_text(json.dumps(known, indent=2, sort_keys=True), encoding="utf-8")


def kept(reference: Reference, commit: str) -> Fetched | None:
    """Return what is kept of a reference at a commit; None if nothing is, or not as it came."""
    fetched = _read(repository_folder(reference) / commit / reference.label)
    return fetched if fetched is not None and _is_whole(fetched.folder) else None


def write_list(fetched: Fetched, path: Path) -> None:
    """Write what `kept` reads; the folder is not part of it.

    Raises:
        OSError: it cannot be written.
    """
    values = {name: value for name, value in asdict(fetched).items() if name != "folder"}
    path.write_text(json.dumps(values, indent=2), encoding="utf-8")


def put_in_place(
    reference: Reference, commit: str, endpoint: str, fill: Callable[[Path], Sequence[str]]
) -> Fetched:
    """Keep a folder of files with its list, both or neither.

    Args:
        reference: what they are of.
        commit: at which.
        endpoint: where they came from.
        fill: writes them into a new folder, and returns their names.

    Raises:
        OSError: they cannot be written.
        Exception: what `fill` raises.
    """
    repository = repository_folder(reference)
    work = Path(mkdtemp(prefix=".new-", dir=repository))
    try:
        folder = work / reference.label
        folder.mkdir()
        names = fill(folder)
        place = repository / commit / reference.label
        fetched = Fetched(
            reference=reference.name,
            kind=reference.kind,
            repository=reference.repository,
            revision=commit,
            endpoint=endpoint,
            fetched=datetime.now(tz=UTC).isoformat(timespec="seconds"),
            folder=place,
            files={name: digest_of(folder / name) for name in names},
            bytes=sum((folder / name).stat().st_size for name in names),
        )
        write_list(fetched, work / "list")
        place.parent.mkdir(exist_ok=True)
        shutil.rmtree(place, ignore_errors=True)  # It was damaged.
        folder.rename(place)
        (work / "list").replace(place.with_name(f"{place.name}.json"))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    forget_checks()
    return fetched


def origin_of(path: Path) -> Fetched | None:
    """Return what a file or folder was fetched as; None for one that was not."""
    try:
        room = cache_dir(_ROOM).resolve()
        parts = path.resolve().relative_to(room).parts
    except (ValueError, StoreError):  # Elsewhere; or there is no cache.
        return None
    return _read(room.joinpath(*parts[:5])) if len(parts) >= 5 else None


def digest_of(path: Path) -> str:
    """Return the hex SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


@cache
def _is_whole(folder: Path) -> bool:
    """Whether all files are there and what they were; looked at once in a process."""
    fetched = _read(folder)
    try:
        return fetched is not None and all(
            digest_of(inside(folder, name)) == digest for name, digest in fetched.files.items()
        )
    except (OSError, OutsideError):
        return False


def forget_checks() -> None:
    """Have folders looked at again: something has been fetched."""
    _is_whole.cache_clear()


def _read(folder: Path) -> Fetched | None:
    """Return what the list beside a folder says; None if there is none, or it is damaged."""
    try:
        with folder.with_name(f"{folder.name}.json").open("rb") as file:
            values: dict[str, Any] = json.loads(file.read(limits.MANIFEST))
        fetched = Fetched(folder=folder, **values)
        texts: list[Any] = [fetched.reference, fetched.revision, fetched.endpoint, fetched.fetched]
        texts += [*fetched.files.keys(), *fetched.files.values()]
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return None
    return fetched if all(isinstance(text, str) for text in texts) else None


def _revisions(reference: Reference) -> dict[str, Any]:
    try:
        with _revisions_file(reference).open("rb") as file:
            known: Any = json.loads(file.read(limits.MANIFEST))
    except (OSError, ValueError, RecursionError):
        return {}
    return cast("dict[str, Any]", known) if isinstance(known, dict) else {}


def _revisions_file(reference: Reference) -> Path:
    return repository_folder(reference) / f"{reference.label}.revisions.json"
