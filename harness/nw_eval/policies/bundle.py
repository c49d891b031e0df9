"""Bundles: a card together with the file of weights that it describes."""

from __future__ import annotations

import hashlib
import json
import stat
from dataclasses import dataclass
from pathlib import Path

from nw_eval.errors import PolicyError, nearest
from nw_eval.inside import OutsideError, inside, what_is
from nw_eval.policies.card import Card
from nw_eval.policies.card_file import CARD_FILE, load_card
from nw_eval.policies.code_digest import code_digest
from nw_eval.policies.observations.plugins import is_code
from nw_eval.shipped import available, shipped

SIZE_LIMIT = 2**30
"""Bytes. The largest policy of this field is some 100 MB."""

NOTHING = hashlib.sha256(b"").hexdigest()
"""The digest of a policy that has neither weights nor code, or whose server gives none."""

_WHEREABOUTS = frozenset({"url", "timeout", "connect_timeout"})
"""Options of remote policies that say where they run and how long to wait."""


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A valid card and a checkpoint: the one whose digest the card says, if it says one."""

    card: Card
    card_path: Path
    checkpoint: Path | None
    """The weights; None for a policy without any."""
    checkpoint_sha256: str
    """Hex digest of the weights; of the code, where there is code and no weights; what the server
    says, for a remote policy, and empty until it was asked; else `NOTHING`."""
    code_sha256: str = ""
    """`code_digest` of the card's folder, if the card imports code; else empty."""

    @property
    def name(self) -> str:
        """The policy's name."""
        return self.card.name

    @property
    def folder(self) -> Path:
        """Where the card lies."""
        return self.card_path.parent

    @property
    def origin(self) -> str:
        """What the digests say, short and in words."""
        told: list[str] = []
        if self.checkpoint_sha256 == NOTHING and self.card.adapter == "remote":
            told.append("the server gives no digest")
        elif self.card.adapter == "remote":
            told.append(f"served {self.checkpoint_sha256[:16]}")
        elif self.checkpoint is not None:
            told.append(self.checkpoint_sha256[:16])
        if self.code_sha256 == NOTHING:
            told.append("no code in the card's folder")
        elif self.code_sha256:
            told.append(f"code {self.code_sha256[:16]}")
        return ", ".join(told) or "no checkpoint"

    @property
    def digest(self) -> str:
        """Hex SHA-256 of all that can change an action: card, weights, code beside the card."""
        fields = self.card.model_dump(
            mode="json", by_alias=True, exclude={"title", "licence", "checkpoint"}
        )
        if self.card.adapter == "remote":
            # Where the same policy is served changes nothing; which one it is, `digest` says.
            options = fields["options"].items()
            fields["options"] = {key: value for key, value in options if key not in _WHEREABOUTS}
        code = [self.code_sha256] if self.code_sha256 else []
        text = json.dumps([fields, self.checkpoint_sha256, *code], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def read_checkpoint(self) -> bytes:
        """Return the bytes of the weights, verified again: what is loaded is what was checked.

        Raises:
            PolicyError: the file is gone, or has changed since the bundle was loaded.
        """
        if self.checkpoint is None:
            return b""
        data = _read(self.checkpoint, self.card_path)
        if hashlib.sha256(data).hexdigest() != self.checkpoint_sha256:
            raise PolicyError(
                f"{self.checkpoint}: the checkpoint changed while it was in use",
                fix="start again once it is no longer written to",
            )
        return data


def load_bundle(
    name_or_path: str | Path, *, search: Path | None = None, checkpoint: Path | None = None
) -> Bundle:
    """Find a bundle, read its card and verify its checkpoint.

    Args:
        name_or_path: name of a shipped bundle or of one in the project's `policies/`, a folder
            with a `policy.yaml` (also relative to the shipped policies), or a card.
        search: the project folder, by default the working directory.
        checkpoint: weights to use in place of those that the card names. They are the caller's
            choice: their digest is computed and recorded, not compared with the card's. So are
            those that a card without a digest names.

    Raises:
        PolicyError: there is no such bundle; the card has problems; the checkpoint is missing,
            too large, outside the card's folder, or has another digest than the card says; the
            code beside the card is too large or cannot be read.
    """
    card_path = find_card(name_or_path, search=search)
    card = load_card(card_path)
    code = code_digest(card_path.parent) if _imports_code(card) else ""
    if card.checkpoint is None:
        if checkpoint is not None:
            raise PolicyError(
                f"{card_path}: policy {card.name!r} has no weights, but --checkpoint gives some",
                fix="drop --checkpoint",
            )
        known = "" if card.adapter == "remote" else code or NOTHING
        return Bundle(
            card=card,
            card_path=card_path,
            checkpoint=None,
            checkpoint_sha256=known,
            code_sha256=code,
        )
    path = checkpoint if checkpoint is not None else _beside(card_path, card.checkpoint.file)
    actual = hashlib.sha256(_read(path, card_path, card.checkpoint.source)).hexdigest()
    wanted = card.checkpoint.sha256
    if checkpoint is None and wanted is not None and actual != wanted:
        raise PolicyError(
            f"{path}: the checkpoint's SHA-256 is {actual}, the card says {wanted}",
            fix="get the right file, or correct `checkpoint.sha256` if this one is meant",
        )
    return Bundle(
        card=card,
        card_path=card_path,
        checkpoint=path,
        checkpoint_sha256=actual,
        code_sha256=code,
    )


def find_card(name_or_path: str | Path, *, search: Path | None = None) -> Path:
    """Return the path of a bundle's card.

    Args:
        name_or_path: as for `load_bundle`.
        search: likewise.

    Raises:
        PolicyError: there is no such bundle.
    """
    known = available("policies", search)
    if str(name_or_path) in known:
        return known[str(name_or_path)] / CARD_FILE
    path = Path(name_or_path)
    kind = what_is(path)
    packed = shipped("policies") / path / CARD_FILE
    if kind == "nothing" and what_is(packed) == "file":
        return packed  # For example `examples/playground-go1`.
    if kind == "folder":
        if what_is(path / CARD_FILE) != "file":
            raise PolicyError(
                f"{path}: the folder has no {CARD_FILE}", fix="write a card, or name another folder"
            )
        return path / CARD_FILE
    if kind == "file":
        if path.suffix not in {".yaml", ".yml"}:
            raise PolicyError(
                f"{path}: a policy is named by its card, not by its weights",
                fix="give a policy.yaml, and these weights with --checkpoint",
            )
        return path
    is_path = "/" in str(name_or_path) or path.suffix in {".yaml", ".yml"}
    missing = (
        "there is no such folder or card" if is_path else "no policy, folder or card is called that"
    )
    raise PolicyError(
        f"unknown policy {str(name_or_path)!r}: {missing}",
        fix=nearest(str(path), known),
    )


def _imports_code(card: Card) -> bool:
    """Whether policy, sensors or wrappers are `module:Class`."""
    return card.adapter.startswith("python:") or any(
        is_code(spec.sensor) or any(is_code(wrap.wrapper) for wrap in spec.wrap)
        for spec in card.observations.values()
    )


def _beside(card_path: Path, file: str) -> Path:
    """Return the path of a checkpoint, which may not leave the card's folder by a link either."""
    try:
        return inside(card_path.parent, file)
    except OutsideError as error:
        raise PolicyError(
            f"{card_path}: checkpoint {file!r} lies outside the card's folder: {error}",
            fix="put the file itself inside, or use --checkpoint",
        ) from None


def _read(path: Path, card_path: Path, source: str | None = None) -> bytes:
    try:
        facts = path.stat()
        if not stat.S_ISREG(facts.st_mode):  # A device or a pipe may never end.
            raise PolicyError(f"{path}: the checkpoint is no file", fix="check the path")
        size = facts.st_size
        if size > SIZE_LIMIT:
            raise PolicyError(
                f"{path}: the checkpoint has {size / 2**20:.0f} MiB, over the limit of "
                f"{SIZE_LIMIT // 2**20}",
                fix="export the actor alone, without optimiser state",
            )
        return path.read_bytes()
    except FileNotFoundError:
        origin = f" (from {source})" if source else ""
        raise PolicyError(
            f"{path}: the checkpoint is missing",
            fix=f"put it{origin} at {card_path.parent}, or give --checkpoint FILE",
        ) from None
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        raise PolicyError(
            f"{path}: the checkpoint cannot be read: "
            f"{(isinstance(error, OSError) and error.strerror) or error}",
            fix="check the path",
        ) from None
