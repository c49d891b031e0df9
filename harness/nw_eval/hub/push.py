"""The other way: a folder's files to a repository of a hub, in one commit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import FetchError, UsageError
from nw_eval.hub.client import open_client, worded
from nw_eval.hub.reference import MAIN, Reference, is_commit


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
            f"{client.endpoint} takes nothing from somebody unknown",
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
                raise ValueError(f"{clean(commit, at_most=60)!r} is no commit")
    except RuntimeError as error:  # What an upload in a thread of its own ends with.
        raise FetchError(
            f"{reference.text}: {clean(error, at_most=200)}", fix="push again"
        ) from error
    return commit
