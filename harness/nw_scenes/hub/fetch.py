"""Fetching: what a reference names becomes a folder in the cache, whole or not at all.

Of each file what is here already is kept, and what is missing asked for.

Robots of MuJoCo Menagerie come through the package `mujoco-menagerie` (`menagerie:NAME`). The
package, an extra, holds a list of robots with their licences and the digest of each archive,
fetches an archive and compares it. What a robot's default model needs of it is kept as a robot's
folder like what comes from a hub, with a robot.yaml that has the name; the rest is derived.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import tarfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

from nw_base.clean import clean
from nw_base.errors import FetchError, PrerequisiteError, StoreError, nearest
from nw_base.plural import in_words, plural
from nw_scenes.hub import limits, listener
from nw_scenes.hub.client import (
    Client,
    Deadline,
    chunks_of,
    open_client,
    opened,
    raise_for,
    unreachable,
    worded,
)
from nw_scenes.hub.contents import RemoteFile, commit_of, files_of, unpack
from nw_scenes.hub.reference import (
    Fetched,
    Reference,
    digest_of,
    forget_checks,
    kept,
    known_commit,
    put_in_place,
    remember_commit,
    repository_folder,
)


def located(reference: Reference) -> Fetched:
    """Return what a reference names: what is kept of it, or else fetched now.

    A branch or tag that was fetched once stays at that commit, with a network or without, until
    `fetch` looks again; what of it is damaged or gone is fetched anew at that commit.

    Raises:
        NwEvalError: as `fetch`.
    """
    commit = known_commit(reference)
    fetched = None if commit is None else kept(reference, commit)
    if fetched is None:
        fetched = fetch(reference if commit is None else replace(reference, revision=commit))
    listener().message(str(fetched))
    return fetched


def fetch(reference: Reference) -> Fetched:
    """Return what a reference names now, fetched as far as it is not kept.

    Raises:
        SceneError, PolicyError, RobotError: by the reference's kind: there is no such repository,
            revision or file, not for this user, or it breaks a limit.
        FetchError: the hub cannot be reached or fails; what came is kept, and gone on from.
        PrerequisiteError: the extra `hub`, or `robots` for MuJoCo Menagerie, is not installed.
        UsageError: HF_ENDPOINT is not an address.
        StoreError: the cache cannot be written.
    """
    fetched = kept(reference, reference.revision) if reference.is_pinned else None
    if fetched is not None:
        return fetched
    client = None if reference.is_of_menagerie else open_client(reference)
    try:
        if client is None:
            with _alone_in(repository_folder(reference)):
                forget_checks()
                fetched = bring_robot(reference)
            commit = fetched.revision
        else:
            with worded(client, reference):
                commit = commit_of(client, reference)
            fetched = kept(reference, commit) or _bring(client, reference, commit)
    except FetchError as error:
        raise _still_kept(reference, error) from None
    except OSError as error:
        raise StoreError(
            f"{reference.text} cannot be kept: {error.strerror or error}",
            fix="free space, or set NW_EVAL_CACHE to a folder that can be written",
        ) from error
    if not reference.is_pinned:
        remember_commit(reference, commit)
    return fetched


def _bring(client: Client, reference: Reference, commit: str) -> Fetched:
    """Fetch all files of a commit into the cache."""
    repository = repository_folder(reference)
    with _alone_in(repository):
        forget_checks()  # Another process may have fetched it while this one waited.
        fetched = kept(reference, commit)
        if fetched is not None:
            return fetched
        with worded(client, reference):
            files = files_of(client, reference, commit)
        parts = {file: _part(reference, file) for file in files}
        _check_space(reference, parts)
        listener().message(
            f"fetching {reference.text}, revision {commit[:12]}: {plural(len(files), 'file')}, "
            f"{in_words(sum(file.size for file in files))}"
        )
        with worded(client, reference):
            for file, part in parts.items():
                download(client, reference, commit, file, part)
        return _put_together(client, reference, commit, parts)


def _put_together(
    client: Client, reference: Reference, commit: str, parts: dict[RemoteFile, Path]
) -> Fetched:
    """Make the folder of files that are here, and its list, and put them into place."""

    def fill(folder: Path) -> list[str]:
        if reference.archive is not None:
            (archive,) = parts.values()
            return list(unpack(reference, archive, folder))
        for file, part in parts.items():
            _link(part, folder / file.path)
        return [file.path for file in parts]

    fetched = put_in_place(reference, commit, client.endpoint, fill)
    for part in parts.values():
        part.unlink(missing_ok=True)
    return fetched


def _part(reference: Reference, file: RemoteFile) -> Path:
    """Return where the bytes of a file come in, which are all there if it was kept before.

    It is called by its content: a file that a newer revision left alone is not fetched again.
    """
    folder = repository_folder(reference) / ".parts"
    folder.mkdir(exist_ok=True)
    part = folder / file.identity
    before = known_commit(reference)
    earlier = None if before is None else kept(reference, before)
    if earlier is not None and not part.exists():
        for name, digest in earlier.files.items():
            there = earlier.folder / name
            # Of another size it would be written to.
            if digest == file.identity and there.stat().st_size == file.size:
                _link(there, part)
                break
    return part


def _link(file: Path, path: Path) -> None:
    """Give a file a second name; a copy, where file systems have but one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        path.hardlink_to(file)
    except OSError:
        shutil.copyfile(file, path)


def _check_space(reference: Reference, parts: dict[RemoteFile, Path]) -> None:
    missing = sum(
        file.size - (part.stat().st_size if part.exists() else 0) for file, part in parts.items()
    )
    repository = repository_folder(reference)
    free = shutil.disk_usage(repository).free
    if missing > free:
        raise StoreError(
            f"{reference.text} needs {in_words(missing)}, and {repository} has room for "
            f"{in_words(free)}",
            fix="free space, or set NW_EVAL_CACHE to a folder with more",
        )


def _still_kept(reference: Reference, error: FetchError) -> FetchError:
    """Return an error that says what is kept, if the network was only to say whether it is new."""
    commit = known_commit(reference)
    stored = None if commit is None else kept(reference, commit)
    if stored is None:
        return error
    return FetchError(f"{error.message}; {stored}, and is what runs use", fix=error.fix)


@contextmanager
def _alone_in(repository: Path) -> Generator[None]:
    """Let one process at a time fetch from a repository."""
    with (repository / ".lock").open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            listener().message("another process is fetching this; waiting for it")
            fcntl.flock(lock, fcntl.LOCK_EX)
        for left in repository.glob(".new-*"):  # Of one that was killed.
            shutil.rmtree(left, ignore_errors=True)
        yield


_PAUSES = (0.5, 2.0, 8.0)
"""Seconds before each further attempt, as long as none brings a byte."""

_PASSING = {429, 500, 502, 503, 504}
"""Statuses of a hub that is busy, or failed, for a moment."""

_SHA1, _SHA256 = 40, 64  # hexadecimal digits


def download(
    client: Client, reference: Reference, commit: str, file: RemoteFile, part: Path
) -> None:
    """Fetch a file, or what is missing of it, and compare it with what the hub says that it is.

    Args:
        client: of the hub.
        reference: what the file is of.
        commit: at which.
        file: which one.
        part: where its bytes go, as they come; they stay if the connection is lost for good.

    Raises:
        FetchError: the network is lost, or what came is not what was announced.
        SlowError: it comes too slowly.
        OSError: it cannot be written.
    """
    pauses = list(_PAUSES)
    with part.open("ab") as out:
        missing = file.size - _size(out, file)
        deadline = Deadline(limits.SECONDS + missing / limits.SLOWEST)
        while (size := _size(out, file)) < file.size:
            broken: Exception | None = None
            try:
                _append(client, reference, commit, file, out, size, deadline)
            except client.errors.HTTPError as error:
                answer = getattr(error, "response", None)  # Of a refusal.
                if answer is not None and answer.status_code not in _PASSING:
                    raise
                broken = error
            reached = _size(out, file)
            if reached > size:
                pauses = list(_PAUSES)
                if reached < file.size:
                    listener().message(_broken(file, reached))
            elif pauses:
                time.sleep(pauses.pop(0))
            else:
                raise _lost(client, reference, file, size, broken)
        out.flush()
        os.fsync(out.fileno())
    listener().fetching(file.path, file.size, file.size)
    if not _is_whole(part, file):
        part.unlink()
        raise FetchError(
            f"{reference.text}: received for {file.path} is not what {client.endpoint} announced",
            fix="fetch it again",
        )


def _append(
    client: Client,
    reference: Reference,
    commit: str,
    file: RemoteFile,
    out: BinaryIO,
    offset: int,
    deadline: Deadline,
) -> None:
    """Append the bytes from `offset` on that one connection brings, at most as announced."""
    url = client.url(reference, commit, file.path)
    headers = {"Range": f"bytes={offset}-"} if offset else {}
    with opened(client, url, headers, deadline) as answers:
        for answer in answers:
            if (named := answer.headers.get("X-Repo-Commit", commit)) != commit:
                raise FetchError(
                    f"{reference.text}: {client.endpoint} gives {file.path} of commit "
                    f"{clean(named, at_most=60)}, not of {commit}",
                    fix="check HF_ENDPOINT and proxy",
                )
        answer = answers[-1]
        if answer.status_code == 416:  # It says that there is nothing from there on.
            out.truncate(0)
            return
        if answer.is_error:
            raise_for(client, answer, deadline)
        if offset and answer.status_code != 206:  # Its answer is the whole file.
            out.truncate(0)
            offset = 0
        for chunk in chunks_of(answer, limits.BYTES, deadline):
            out.write(chunk[: file.size - offset])
            offset += len(chunk)
            listener().fetching(file.path, min(offset, file.size), file.size)
            if offset >= file.size:
                return


def _size(out: BinaryIO, file: RemoteFile) -> int:
    """Return how many bytes are here; what is longer than the file is none of it."""
    size = out.seek(0, os.SEEK_END)
    if size > file.size:
        out.truncate(0)
        return 0
    return size


def _is_whole(part: Path, file: RemoteFile) -> bool:
    with part.open("rb") as content:
        if len(file.identity) == _SHA256:
            return hashlib.file_digest(content, "sha256").hexdigest() == file.identity
        # What Git calls a blob: its SHA-1 has a header.
        digest = hashlib.sha1(b"blob %d\0" % file.size, usedforsecurity=False)
        while chunk := content.read(2**20):
            digest.update(chunk)
    return len(file.identity) == _SHA1 and digest.hexdigest() == file.identity


def _broken(file: RemoteFile, size: int) -> str:
    return (
        f"the connection broke at {in_words(size)} of {in_words(file.size)} of {file.path}; "
        "going on from there"
    )


def _lost(
    client: Client, reference: Reference, file: RemoteFile, size: int, error: Exception | None
) -> FetchError:
    lost = unreachable(client, reference, error or EOFError("it sends nothing"))
    return FetchError(
        f"{lost.message}; {in_words(size)} of {in_words(file.size)} of {file.path} are here",
        fix="run the same command again to resume",
    )


_YAML = """\
# {title} of MuJoCo Menagerie, licence {licence}, revision {revision}.
# All that is not here is derived from the model file.
nw-robot: 1
name: {name}
model: {{file: {file}, sha256: {digest}}}
"""


def bring_robot(reference: Reference) -> Fetched:
    """Return a robot as the installed package has it, fetched as far as it is not kept.

    Raises:
        RobotError: the package knows no such robot, or it has another revision.
        FetchError: it cannot be fetched, or what came is not what the package announces.
        PrerequisiteError: the extra `robots` is not installed.
        OSError: it cannot be kept.
    """
    try:
        module: Any = import_module("mujoco_menagerie")
    except ImportError as error:
        raise PrerequisiteError(
            f"{reference.text} needs the package mujoco-menagerie: {error}",
            fix="pip install 'nw-eval[robots]'",
        ) from None
    if not hasattr(tarfile, "data_filter"):  # The package unpacks archives with it.
        raise PrerequisiteError(
            f"{reference.text} needs Python 3.11.4 or newer, this is {platform.python_version()}",
            fix="use a newer Python, or give robot.yaml and its model as a folder",
        )
    name, installed = reference.label, f"mujoco-menagerie {version('mujoco-menagerie')}"
    try:
        robot = module.get(name)
    except LookupError:
        raise reference.error(
            f"{installed} has no robot {name!r}", fix=nearest(name, module.names())
        ) from None
    if reference.is_pinned and reference.revision != robot.oid:
        raise reference.error(
            f"{installed} has revision {robot.oid} of it",
            fix=f"write {reference.name}, or install the version of the package that has yours",
        )
    fetched = kept(reference, robot.oid)
    if fetched is not None:
        return fetched
    listener().message(f"fetching {reference.name}, revision {robot.oid[:12]}: {installed}")
    try:
        root = robot.path(progress=listener().fetching).resolve()
        entry = robot.default_model
        if robot.default_scene is not None and not _has_pose(robot.files(entry)):
            # Its keyframes stand in the file with the floor, which is left out of a robot.
            scene = robot.default_scene
            entry = scene if _has_pose(robot.files(scene)) else entry
        files = [path.resolve() for path in robot.files(entry)]
    except module.MenagerieError as error:
        raise FetchError(
            f"{reference.text}: {clean(error, at_most=300)}",
            fix="check the network and proxy; fetched files need no network",
        ) from None
    own = [path for path in (root / "LICENSE", root / "README.md") if path.is_file()]
    names = sorted({str(path.relative_to(root)) for path in (*files, *own)})

    def fill(folder: Path) -> list[str]:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, folder / name)
        model = robot.entry(entry).file
        text = _YAML.format(
            title=robot.display_name,
            licence=robot.license,
            revision=robot.oid,
            name=robot.name,
            file=model,
            digest=digest_of(folder / model),
        )
        (folder / "robot.yaml").write_text(text, encoding="utf-8")
        return [*names, "robot.yaml"]

    return put_in_place(reference, robot.oid, "mujoco-menagerie", fill)


def _has_pose(files: list[Path]) -> bool:
    """Whether a model has a keyframe, in any of its files."""
    return any(path.suffix == ".xml" and b"<key " in path.read_bytes() for path in files)
