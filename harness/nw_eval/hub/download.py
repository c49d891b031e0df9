"""One file from a hub: what is here already is kept, and what is missing asked for."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path
from typing import BinaryIO

from nw_eval.amounts import in_words
from nw_eval.clean import clean
from nw_eval.errors import FetchError
from nw_eval.hub import limits
from nw_eval.hub.client import Client, Deadline, chunks_of, opened, raise_for, unreachable
from nw_eval.hub.listener import listener
from nw_eval.hub.listing import RemoteFile
from nw_eval.hub.reference import Reference

_PAUSES = (0.5, 2.0, 8.0)
"""Seconds before each further attempt, as long as none brings a byte."""

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
        while (here := _size(out, file)) < file.size:
            broken: Exception | None = None
            try:
                _append(client, reference, commit, file, out, here, deadline)
            except client.errors.HTTPError as error:
                if isinstance(error, client.errors.HfHubHTTPError):
                    raise
                broken = error
            reached = _size(out, file)
            if reached > here:
                pauses = list(_PAUSES)
                if reached < file.size:
                    listener().message(_broken(file, reached))
            elif pauses:
                time.sleep(pauses.pop(0))
            else:
                raise _lost(client, reference, file, here, broken)
        out.flush()
        os.fsync(out.fileno())
    listener().fetching(file.path, file.size, file.size)
    if not _is_whole(part, file):
        part.unlink()
        raise FetchError(
            f"{reference.text}: what came as {file.path} is not what {client.endpoint} announced",
            fix="fetch it again",
        )


def _append(
    client: Client,
    reference: Reference,
    commit: str,
    file: RemoteFile,
    out: BinaryIO,
    here: int,
    deadline: Deadline,
) -> None:
    """Append what one connection brings of the bytes from `here` on, and no more than announced."""
    url = client.url(reference, commit, file.path)
    headers = {"Range": f"bytes={here}-"} if here else {}
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
        if here and answer.status_code != 206:  # Its answer is the whole file.
            out.truncate(0)
            here = 0
        for chunk in chunks_of(answer, limits.BYTES, deadline):
            out.write(chunk[: file.size - here])
            here += len(chunk)
            listener().fetching(file.path, min(here, file.size), file.size)
            if here >= file.size:
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


def _broken(file: RemoteFile, here: int) -> str:
    return (
        f"the connection broke at {in_words(here)} of {in_words(file.size)} of {file.path}; "
        "going on from there"
    )


def _lost(
    client: Client, reference: Reference, file: RemoteFile, here: int, error: Exception | None
) -> FetchError:
    lost = unreachable(client, reference, error or EOFError("it sends nothing"))
    return FetchError(
        f"{lost.message}; {in_words(here)} of {in_words(file.size)} of {file.path} are here",
        fix="the same command goes on from there",
    )
