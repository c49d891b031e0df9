"""A file of weights as a card names it: where it lies, and the digest that it must have."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator

from nw_eval.cards.model import CardModel, Line
from nw_eval.inside import OutsideError, checked


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
