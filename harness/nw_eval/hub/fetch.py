"""Fetching: what a reference names becomes a folder in the cache, whole or not at all."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import mkdtemp

from nw_eval.amounts import in_words
from nw_eval.errors import FetchError, StoreError
from nw_eval.hub.client import Client, open_client, worded
from nw_eval.hub.download import download
from nw_eval.hub.fetched import (
    Fetched,
    digest_of,
    forget_checks,
    kept,
    known_commit,
    remember_commit,
    repository_folder,
    write_list,
)
from nw_eval.hub.listener import listener
from nw_eval.hub.listing import RemoteFile, commit_of, files_of
from nw_eval.hub.reference import Reference
from nw_eval.hub.unpack import unpack
from nw_eval.plural import plural


def located(reference: Reference) -> Fetched:
    """Return what a reference names: what is kept of it, or else fetched now.

    A branch or tag that was fetched once stays at that commit, with a network or without, until
    `fetch` looks again; what of it is damaged or gone is fetched anew at that commit.

    Raises:
        SceneError, PolicyError, FetchError, PrerequisiteError, StoreError, UsageError: as `fetch`.
    """
    commit = known_commit(reference)
    found = None if commit is None else kept(reference, commit)
    if found is None:
        found = fetch(reference if commit is None else replace(reference, revision=commit))
    listener().message(str(found))
    return found


def fetch(reference: Reference) -> Fetched:
    """Return what a reference names now, fetched as far as it is not kept.

    Raises:
        SceneError, PolicyError: by the reference's kind: there is no such repository, revision or
            file, not for this user, or it breaks a limit.
        FetchError: the hub cannot be reached or fails; what came is kept, and gone on from.
        PrerequisiteError: the extra `hub` is not installed.
        UsageError: HF_ENDPOINT is no address.
        StoreError: the cache cannot be written.
    """
    found = kept(reference, reference.revision) if reference.is_pinned else None
    if found is not None:
        return found
    client = open_client(reference)
    try:
        with worded(client, reference):
            commit = commit_of(client, reference)
        found = kept(reference, commit) or _bring(client, reference, commit)
    except FetchError as error:
        raise _still_kept(reference, error) from None
    except OSError as error:
        raise StoreError(
            f"{reference.text} cannot be kept: {error.strerror or error}",
            fix="free space, or set NW_EVAL_CACHE to a folder that can be written",
        ) from error
    if not reference.is_pinned:
        remember_commit(reference, commit)
    return found


def _bring(client: Client, reference: Reference, commit: str) -> Fetched:
    """Fetch all files of a commit into the cache."""
    repository = repository_folder(reference)
    with _alone_in(repository):
        forget_checks()  # Another process may have fetched it while this one waited.
        found = kept(reference, commit)
        if found is not None:
            return found
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
    repository = repository_folder(reference)
    work = Path(mkdtemp(prefix=".new-", dir=repository))
    try:
        folder = work / reference.label
        folder.mkdir()
        names = [file.path for file in parts]
        if reference.archive is not None:
            (archive,) = parts.values()
            names = unpack(reference, archive, folder)
        else:
            for file, part in parts.items():
                _link(part, folder / file.path)
        place = repository / commit / reference.label
        fetched = Fetched(
            reference=reference.name,
            kind=reference.kind,
            repository=reference.repository,
            revision=commit,
            endpoint=client.endpoint,
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
    for part in parts.values():
        part.unlink(missing_ok=True)
    forget_checks()
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
    found = None if commit is None else kept(reference, commit)
    if found is None:
        return error
    return FetchError(f"{error.message}; {found}, and is what runs use", fix=error.fix)


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
