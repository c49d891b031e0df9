"""The hub's own client, its failures in words, and the way of a folder's files to a repository.

`huggingface_hub` is an extra: nothing imports it but this module, and only when something is to be
fetched or pushed. It says who one is (`HF_TOKEN`, `hf auth login`) and which hub is meant
(`HF_ENDPOINT`).
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from nw_base.clean import clean
from nw_base.errors import FetchError, PrerequisiteError, UsageError
from nw_scenes.hub import limits
from nw_scenes.hub.reference import MAIN, Reference, is_commit

SILENCE = 30.0
"""Seconds without a byte after which a connection counts as broken."""

_REDIRECTS = 8
_WHO = "set HF_TOKEN, or log in with `hf auth login`"


@dataclass(frozen=True, kw_only=True)
class Client:
    """A hub, and what speaks with it."""

    endpoint: str
    module: Any
    """`huggingface_hub`."""
    utils: Any
    errors: Any
    api: Any
    """Its `HfApi` for this endpoint."""

    @property
    def has_token(self) -> bool:
        """Whether this user is anybody on the hub."""
        return bool(self.module.get_token())

    def url(self, reference: Reference, commit: str, path: str) -> str:
        """Return the address of a file of a repository."""
        return self.module.hf_hub_url(
            reference.repository,
            path,
            repo_type=reference.repository_type,
            revision=commit,
            endpoint=self.endpoint,
        )


def open_client(reference: Reference) -> Client:
    """Return the client of the hub that the environment names, huggingface.co otherwise.

    Args:
        reference: what it is wanted for.

    Raises:
        PrerequisiteError: the extra is not installed.
        UsageError: HF_ENDPOINT is not an address.
    """
    try:
        module: Any = import_module("huggingface_hub")
        utils, errors, constants = (
            import_module(f"huggingface_hub.{name}") for name in ("utils", "errors", "constants")
        )
    except ImportError as error:
        raise PrerequisiteError(
            f"{reference.text} needs the package huggingface_hub: {error}",
            fix="pip install 'nw-eval[hub]'",
        ) from None
    # Its warnings are of retries, which are told in our words.
    utils.logging.set_verbosity_error()
    endpoint = (os.environ.get("HF_ENDPOINT") or str(constants.ENDPOINT)).rstrip("/")
    if not endpoint.startswith(("https://", "http://")):
        raise UsageError(
            f"HF_ENDPOINT {clean(endpoint, at_most=100)!r} is not an address",
            fix="give https://...",
        )
    return Client(
        endpoint=endpoint,
        module=module,
        utils=utils,
        errors=errors,
        api=module.HfApi(endpoint=endpoint, library_name="nw-eval"),
    )


class SlowError(Exception):
    """A hub takes longer in all than it may, though its connection is not broken."""


class Deadline:
    """A time by which all is to be done.

    Args:
        seconds: from now on.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds, self._end = seconds, time.monotonic() + seconds

    @property
    def left(self) -> float:
        """Seconds, more than none.

        Raises:
            SlowError: it has passed.
        """
        left = self._end - time.monotonic()
        if left <= 0.0:
            raise SlowError(f"it takes over {self._seconds:.0f} s")
        return left


@contextmanager
def opened(
    client: Client, url: str, headers: dict[str, str], deadline: Deadline
) -> Generator[tuple[Any, ...]]:
    """Give the answers to a request, redirects first; nothing of them is read but their headers.

    Args:
        client: of the hub.
        url: to fetch.
        headers: besides those that say who asks.
        deadline: for the headers.

    Raises:
        SlowError: the headers do not come in time.
    """
    session: Any = client.module.get_session()
    known = client.utils.build_hf_headers(library_name="nw-eval")
    # Compressed bytes have other places than those of the file, and no size before they are read.
    known |= {"Accept-Encoding": "identity"} | headers
    request = session.build_request("GET", url, headers=known, timeout=SILENCE)
    answers: list[Any] = []
    try:
        while request is not None and len(answers) <= _REDIRECTS:
            answers.append(_answer(session, request, deadline))
            # Its body is not read; a redirect's may have no end.
            request = answers[-1].next_request
        yield tuple(answers)
    finally:
        for answer in answers:
            answer.close()


def _answer(session: Any, request: Any, deadline: Deadline) -> Any:
    """Return the headers of an answer, in time: the library limits the silence between two bytes.

    Raises:
        SlowError: they do not come in time.
        Exception: the library's own.
    """
    answers: SimpleQueue[Any] = SimpleQueue()
    gone = threading.Event()

    def ask() -> None:
        try:
            answer = session.send(request, stream=True, follow_redirects=False)
        except Exception as error:  # noqa: BLE001 - It is raised where it was asked.
            answers.put(error)
            return
        answers.put(answer)
        if gone.is_set():
            answer.close()

    left = min(deadline.left, limits.SECONDS)
    threading.Thread(target=ask, name="hub", daemon=True).start()
    try:
        answer = answers.get(timeout=left)
    except Empty:
        gone.set()
        raise SlowError(f"no answer came within {left:.0f} s") from None
    if isinstance(answer, Exception):
        raise answer
    return answer


def chunks_of(answer: Any, most: int, deadline: Deadline) -> Iterator[bytes]:
    """Yield the bytes of an answer as they come.

    Raises:
        ValueError: there are more than `most`.
        SlowError: they do not come in time.
    """
    size = 0
    for chunk in answer.iter_raw():
        _ = deadline.left
        size += len(chunk)
        if size > most:
            raise ValueError(f"an answer has over {most / 2**20:g} MiB")
        yield chunk


def json_of(client: Client, url: str, deadline: Deadline) -> tuple[Any, str | None]:
    """Return what the hub answers, and the address of the next page; None if it is the last.

    Raises:
        ValueError: it is no JSON, has over `limits.JSON` bytes, or the next page lies elsewhere.
        SlowError: it does not come in time.
        Exception: the library's own, for what the hub refuses.
    """
    with opened(client, url, {}, deadline) as answers:
        answer = answers[-1]
        if answer.is_error:
            raise_for(client, answer, deadline)
        body = b"".join(chunks_of(answer, limits.JSON, deadline))
        following = answer.links.get("next", {}).get("url")
    if following is not None and not following.startswith(f"{client.endpoint}/"):
        raise ValueError("the next page of its listing lies elsewhere")
    return json.loads(body), following


def raise_for(client: Client, answer: Any, deadline: Deadline) -> None:
    """Raise the library's error for an answer that is a refusal.

    The library reads all of such an answer for its words, so it is given one that is read.
    """
    body = b"".join(chunks_of(answer, limits.JSON, deadline))
    kept = {name: word for name, word in answer.headers.items() if not name.startswith("content-")}
    client.utils.hf_raise_for_status(
        type(answer)(answer.status_code, headers=kept, content=body, request=answer.request)
    )


@contextmanager
def worded(client: Client, reference: Reference) -> Generator[None]:
    """Let what the hub refuses, and what keeps one from it, be errors of ours.

    Raises:
        SceneError, PolicyError: by the reference's kind: there is no such repository, revision or
            file, or not for this user.
        FetchError: the hub cannot be reached, or fails.
    """
    errors = client.errors
    try:
        yield
    except errors.GatedRepoError:
        page = client.url(reference, reference.revision, "").partition("/resolve/")[0]
        raise reference.error(
            "its owner must grant you access",
            fix=f"ask for it at {page}, then {_WHO}",
        ) from None
    except errors.RepositoryNotFoundError:
        raise _unknown(client, reference) from None
    except errors.RevisionNotFoundError:
        raise reference.error(
            f"{reference.repository} has no revision {reference.revision!r}",
            fix="name a branch, a tag or a commit in full",
        ) from None
    except errors.RemoteEntryNotFoundError as error:
        raise reference.error(
            f"{client.endpoint} has no such file: {_first_line(error)}", fix="check the name"
        ) from None
    except errors.HfHubHTTPError as error:
        status = error.response.status_code
        if status in {401, 403}:
            refused = "its token" if client.has_token else "anybody without a token"
            raise reference.error(
                f"{client.endpoint} refuses {refused} ({status})", fix=_WHO
            ) from None
        raise FetchError(
            f"{reference.text}: {client.endpoint} answers {status}: {_first_line(error)}",
            fix="try again later",
        ) from None
    except errors.OfflineModeIsEnabled:
        raise FetchError(
            f"{reference.text} is not kept here, and HF_HUB_OFFLINE forbids the network",
            fix="unset HF_HUB_OFFLINE",
        ) from None
    except (errors.HTTPError, SlowError) as error:
        raise unreachable(client, reference, error) from None
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise FetchError(
            f"{reference.text}: {client.endpoint} does not answer as a hub does: "
            f"{type(error).__name__}: {_first_line(error)}",
            fix="check HF_ENDPOINT, proxy and firewall",
        ) from None


def unreachable(client: Client, reference: Reference, error: Exception) -> FetchError:
    """Return the error of a network that is not there, or too slow."""
    what = "fetch all from" if isinstance(error, SlowError) else "reach"
    return FetchError(
        f"{reference.text}: cannot {what} {client.endpoint}: {_first_line(error)}",
        fix="check the network, proxy and HF_ENDPOINT; fetched files need no network",
    )


def _unknown(client: Client, reference: Reference) -> Exception:
    kind = "data set" if reference.kind == "scene" else "model"
    fix = f"check the name; if it is private, {_WHO}"
    if client.has_token:
        fix = "check the name, and that the token may read it"
    return reference.error(
        f"{client.endpoint} has no {kind} {reference.repository!r}, or not for you", fix=fix
    )


def _first_line(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return clean(text.splitlines()[0], at_most=200)


def push(reference: Reference, files: Mapping[str, Path], *, private: bool, message: str) -> str:
    """Put files into a repository, which is made if it is not there, and return the commit.

    Files of the repository that are not named stay as they are.

    Args:
        reference: where to; without a revision.
        files: by their names in the repository.
        private: whether a repository that is made is for its owner alone.
        message: what the commit is called.

    Raises:
        UsageError: the reference names a revision.
        SceneError, PolicyError: by the reference's kind: the hub does not let this user.
        FetchError: the hub cannot be reached or fails; nothing was changed.
        PrerequisiteError: the extra `hub` is not installed.
    """
    if reference.revision != MAIN:
        raise UsageError(
            f"{reference.text}: a push makes a new revision of {MAIN}",
            fix=f"write hub:{reference.repository}",
        )
    client = open_client(reference)
    if not client.has_token:
        raise reference.error(
            f"{client.endpoint} does not accept uploads without a login",
            fix="set HF_TOKEN to a token that may write, or log in with `hf auth login`",
        )
    operations = [
        client.module.CommitOperationAdd(path_in_repo=name, path_or_fileobj=str(path))
        for name, path in files.items()
    ]
    where: dict[str, Any] = {
        "repo_id": reference.repository,
        "repo_type": reference.repository_type,
    }
    try:
        with worded(client, reference):
            client.api.create_repo(**where, private=private or None, exist_ok=True)
            done: Any = client.api.create_commit(
                **where, operations=operations, commit_message=message
            )
            commit = str(done.oid)
            if not is_commit(commit):
                raise ValueError(f"{clean(commit, at_most=60)!r} is not a commit")
    except RuntimeError as error:  # What an upload in a thread of its own ends with.
        raise FetchError(
            f"{reference.text}: {clean(error, at_most=200)}", fix="push again"
        ) from error
    return commit
