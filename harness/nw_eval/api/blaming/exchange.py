"""Two policies taken apart, and put together crosswise: one's control with the other's sight.

Sight is what a card says of sensors of the world around (images, depth, classes, heights, laser
scanners) and of where cameras sit; control is all the rest: weights, gains, what an action means,
and what the robot feels of itself or is told.
"""

from __future__ import annotations

import shutil
from io import StringIO
from pathlib import Path
from typing import Any

from nw_eval.cards import Card
from nw_eval.cards.load import CARD_FILE
from nw_eval.errors import PolicyError, StoreError
from nw_eval.gate.cause.two_by_two import Apart
from nw_eval.policies import Bundle

SIGHT = frozenset({"splat_rgb", "depth", "semantics", "scandots", "heightmap", "lidar"})
"""Sensors of the world around."""
_LABELS = ("name", "title", "licence", "nw-policy", "checkpoint")


def apart(old: Bundle, new: Bundle) -> Apart:
    """Return in what two policies differ.

    Raises:
        PolicyError: they cannot be taken apart, or their sights cannot be exchanged.
    """
    for bundle in (old, new):
        if bundle.card.networks or bundle.instance is not None or bundle.card.adapter == "remote":
            what = "networks of its own" if bundle.card.networks else "no files here"
            raise PolicyError(
                f"{bundle.subject} has {what}, and cannot be taken apart into sight and control",
                fix="`nw-eval blame` without --cause says since when its trials were lost",
            )
    one, other = (set(_sight(bundle.card)) for bundle in (old, new))
    if not one or one != other:
        raise PolicyError(
            f"the sights of {old.name} ({_named(one)}) and {new.name} ({_named(other)}) cannot be "
            "exchanged: their observations have other names",
            fix="compare policies whose networks take the same inputs",
        )
    cards = [_plain(bundle.card) for bundle in (old, new)]
    sights = [{name: card["observations"][name] for name in sorted(one)} for card in cards]
    mounts = [card.get("cameras", {}) for card in cards]
    rests = [
        {
            **{key: value for key, value in card.items() if key not in {*_LABELS, "cameras"}},
            "observations": {n: o for n, o in card["observations"].items() if n not in one},
        }
        for card in cards
    ]
    weights = old.checkpoint_digest != new.checkpoint_digest or old.code_sha256 != new.code_sha256
    return Apart(
        sight=sights[0] != sights[1] or mounts[0] != mounts[1],
        rest=rests[0] != rests[1],
        weights=weights,
    )


def write_crossed(folder: Path, control: Bundle, sight: Bundle, *, name: str) -> Path:
    """Write the card of one policy with the sight of another one; return its file.

    Weights stay where they are; Python code is copied beside the card.

    Raises:
        StoreError: it cannot be written.
    """
    card, other = _plain(control.card), _plain(sight.card)
    seen = _sight(control.card)
    card["observations"] = {
        key: other["observations"][key] if key in seen else value
        for key, value in card["observations"].items()
    }
    card |= {"name": name, "title": f"control of {control.name}, sight of {sight.name}"}
    card.pop("cameras", None)
    if "cameras" in other:
        card["cameras"] = other["cameras"]
    try:
        if control.code_sha256:
            shutil.copytree(control.folder, folder)
        else:
            folder.mkdir(parents=True)
        path = folder / CARD_FILE
        path.write_text(_yaml(card), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror or error}") from error
    return path


def _sight(card: Card) -> list[str]:
    return [name for name, each in card.observations.items() if each.sensor in SIGHT]


def _plain(card: Card) -> dict[str, Any]:
    found = card.model_dump(mode="json", by_alias=True, exclude_unset=True)
    for name, each in card.observations.items():
        found["observations"][name]["rate"] = each.rate  # Whatever the other one's default is.
    return found


def _named(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _yaml(card: dict[str, Any]) -> str:
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(card, stream)
    return stream.getvalue()
