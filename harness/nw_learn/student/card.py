"""The student's card: the motors and the command of its teacher, and eyes of its own."""

from __future__ import annotations

from io import StringIO
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML

from nw_base.errors import UsageError
from nw_places.entries import parted
from nw_places.splits import split_of
from nw_policies.cards.card import LEFT_OUT
from nw_policies.cards.model import CONTROL_RATE
from nw_sim.catalogue import is_meant, names, parse_reference

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_learn.student.config import Sees
    from nw_policies.cards import Card

NETWORK_FILE = "policy.onnx"
ENCODER_FILE = "encoder.onnx"
"""What is made of images alone, once an image."""
SEEN = "seen"
"""The network of that file on the card, and the input of the other one that takes what it gives."""

DEPTH_STEPS = 255
"""Depths that a student tells apart, so that its images are bytes in every dataset."""

BODY = ("proprio", "last_output", "history", "past")
"""The observations that are joined to one row of numbers, in this order."""

_NOW, _BEFORE = ["0:5", "13:53"], ["3:5", "13:25", "49:53"]
"""Numbers of the layout `parkour53`: without direction, speed and mask; and of a posture alone."""
_DIRECTION = 6
_RECENT = 3
"""Frames of 0.02 s before the present one, from which velocities show."""
_PAST = {"rate": 10, "history": {"steps": 8, "order": "newest_first"}}
"""Postures of the last 0.8 s: legs cross what the camera saw before."""


def check_teacher(card: Card) -> None:
    """Refuse a teacher whose actions no student can learn.

    Raises:
        UsageError: it does not act in every control step.
    """
    if card.control.hold != 1 or card.control.step_rate != CONTROL_RATE:
        raise UsageError(
            f"teacher {card.name!r} acts {card.control.rate} times a second, students 50 times",
            fix="name a teacher of 50 Hz",
        )


def observations(sees: Sees) -> dict[str, dict[str, Any]]:
    """Return what the card of a student observes, by name."""
    layout = {"sensor": "proprio", "layout": "parkour53"}
    terms = [_NOW[0], _DIRECTION, _NOW[1]] if sees.direction else _NOW
    entries: dict[str, dict[str, Any]] = {
        "proprio": {**layout, "select": terms},
        "last_output": {"sensor": "proprio", "terms": ["last_output"]},
        "history": {
            **layout,
            "select": _NOW,
            "history": {"steps": _RECENT, "order": "newest_first", "current": False},
        },
        "past": {**layout, "select": _BEFORE, **_PAST},
    }
    camera = {
        "camera": "ego",
        "width": sees.width,
        "height": sees.height,
        "rate": sees.rate,
        "cones": sees.cones,
    }
    if sees.rgb:
        stack = {"stack": sees.frames, "stack_axis": "channel"} if sees.frames > 1 else {}
        entries["rgb"] = {"sensor": "splat_rgb", **camera, "axes": "chw", **stack}
    if sees.depth:
        last = {"wrapper": "stack", "steps": sees.frames, "axis": "first"}
        alone = {"wrapper": "channels", "axis": "first"}
        entries["depth"] = {
            "sensor": "depth",
            **camera,
            "mode": "linear",
            "clip": sees.depth_clip,
            "wrap": [
                {"wrapper": "quantize", "step": 1.0 / DEPTH_STEPS},
                last if sees.frames > 1 else alone,
            ],
        }
    return entries


def student_card(
    name: str,
    sees: Sees,
    teacher: Card,
    *,
    sha256: Mapping[str, str],
    is_blind: bool = False,
    scenes: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the card of a student, as its file says it.

    Args:
        name: of the policy.
        sees: what it is given.
        teacher: whose motors, actions and command it has.
        sha256: of its files, which lie beside the card, by their names.
        is_blind: whether its network has one image for good, and takes none.
        scenes: of its training, as its config names them.
    """
    seen = {name: spec for name, spec in observations(sees).items() if name in BODY or not is_blind}
    trained_on = _trained_on(scenes)
    eyes = " and ".join(sees.cameras)
    title = f"ACT student of {teacher.name}, {eyes}"
    control = teacher.control.model_dump(mode="json", exclude_defaults=True)
    encoder = {
        "adapter": "onnx",
        "checkpoint": {"file": ENCODER_FILE, "sha256": sha256.get(ENCODER_FILE, "")},
        "inputs": {eye: [eye] for eye in sees.cameras},
    }
    return {
        "nw-policy": 1,
        "name": name,
        "title": f"{title}: the mean image at all times" if is_blind else title,
        "licence": teacher.licence,
        **({"trained_on": trained_on} if trained_on else {}),
        "robot": teacher.robot,
        "adapter": "onnx",
        "checkpoint": {"file": NETWORK_FILE, "sha256": sha256[NETWORK_FILE]},
        "control": {"action": teacher.control.action, **control},
        "command": teacher.command.model_dump(mode="json"),
        "observations": seen,
        **({} if is_blind else {"networks": {SEEN: encoder}}),
        "inputs": {"proprio": list(BODY)} | ({} if is_blind else {SEEN: [SEEN]}),
    }


def card_text(card: dict[str, Any]) -> str:
    """Return a card as the text of its file."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(card, stream)
    return stream.getvalue()


def _trained_on(patterns: Sequence[str]) -> list[str]:
    """Return a training's scenes as a card names them: built-in ones, without evaluation scenes.

    Globs name evaluation scenes too, which every training leaves out; and a glob over variants, as
    `gaps/*~3`, is shorter than the names that it stands for. So the card says both.
    """
    plain = [parse_reference(pattern)[0] for pattern in patterns]
    splits = {
        pattern: {split_of(name) for name in names() if is_meant(name, parted(pattern)[0])}
        for pattern in plain
    }
    kept = [pattern for pattern in splits if splits[pattern] - {"eval"}]
    if any("eval" in splits[pattern] for pattern in kept):
        kept.append(f"{LEFT_OUT}split:eval")
    return kept
