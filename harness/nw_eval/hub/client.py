"""The hub's own client, and its failures in words.

`huggingface_hub` is an extra: nothing imports it but this module, and only when something is to be
fetched or pushed. It says who one is (`HF_TOKEN`, `hf auth login`) and which hub is meant
(`HF_ENDPOINT`).
"""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import FetchError, PrerequisiteError, UsageError
from nw_eval.hub.reference import Reference

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
        UsageError: HF_ENDPOINT is no address.
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
            f"HF_ENDPOINT {clean(endpoint, at_most=100)!r} is no address", fix="give https://..."
        )
    return Client(
        endpoint=endpoint,
        module=module,
        utils=utils,
        errors=errors,
        api=module.HfApi(endpoint=endpoint, library_name="nw-eval"),
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
            "its owner lets in only whom he has granted access",
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
    except errors.HTTPError as error:
        raise unreachable(client, reference, error) from None
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise FetchError(
            f"{reference.text}: {client.endpoint} does not answer as a hub does: "
            f"{type(error).__name__}: {_first_line(error)}",
            fix="check HF_ENDPOINT, proxy and firewall",
        ) from None


def unreachable(client: Client, reference: Reference, error: Exception) -> FetchError:
    """Return the error of a network that is not there."""
    return FetchError(
        f"{reference.text}: cannot reach {client.endpoint}: {_first_line(error)}",
        fix="check the network, proxy and HF_ENDPOINT; what was fetched once needs none",
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
