"""A file of weights as a card names it: how it is run, where it lies, and its digest."""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeGuard, get_args

from pydantic import AfterValidator

from nw_eval.cards.model import CardModel, Line
from nw_eval.errors import nearest
from nw_eval.files.inside import OutsideError, checked

NetworkAdapter = Literal["onnx", "torchscript", "torch-export"]
"""What runs a file that may also be a network which feeds another."""
BuiltInAdapter = Literal[
    NetworkAdapter, "mlp", "lucidsim", "extreme-parkour", "act", "remote", "zero"
]
"""The table of adapters; what opens each of them stands in `policies.opening`."""

ADAPTERS: tuple[str, ...] = get_args(BuiltInAdapter)


def is_built_in(adapter: str) -> TypeGuard[BuiltInAdapter]:
    """Whether an adapter of a card is one of ours rather than `python:package.module:Class`."""
    return adapter in ADAPTERS


def _known_adapter(name: str) -> str:
    if is_built_in(name) or re.fullmatch(r"python:[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    if name.startswith("python:"):
        message = f"{name!r} names no class; write python:package.module:Class"
        raise ValueError(message)
    message = f"unknown adapter {name!r}; {nearest(name, ADAPTERS)}"
    raise ValueError(message)


Adapter = Annotated[str, AfterValidator(_known_adapter)]


def _plain_file(name: str) -> str:
    try:
        checked(name)
    except OutsideError as error:
        message = f"{name!r} leaves the card's folder: {error}"
        raise ValueError(
            f"{message}; name a file inside it; only --checkpoint may name one elsewhere"
        ) from None
    return name


def _sha256(digest: str) -> str:
    if not re.fullmatch(r"[0-9a-fA-F]{64}", digest):
        message = f"{digest[:20]!r} is not a SHA-256, which has 64 hex digits, not {len(digest)}"
        raise ValueError(f"{message}; `sha256sum FILE` prints it")
    return digest.lower()


Sha256 = Annotated[str, AfterValidator(_sha256)]


class Checkpoint(CardModel):
    """The file of weights, and the digest that it must have."""

    file: Annotated[str, AfterValidator(_plain_file)]
    """Path inside the card's folder."""
    sha256: Sha256 | None = None
    """Hex digest that the file must have; None = whatever lies there is taken, and recorded."""
    source: Line | None = None
    """Where people get the file if it does not lie beside the card."""
