"""A teacher as a policy: a card and its weights, as `nw-eval run --policy` takes them."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path

from nw_eval.cards.load import CARD_FILE
from nw_eval.files.cache import atomic_path
from nw_eval.learn.program.folder import TrainFolder, read_state
from nw_eval.learn.teacher.ppo.networks import Actor
from nw_eval.learn.teacher.start import load_network
from nw_eval.learn.teacher.weights import write_actor

_CHECKPOINT = "policy.onnx"
_CARD = """\
nw-policy: 1
name: {name}
title: parkour teacher on terrain heights, trained by nw-eval
robot: go1
adapter: onnx
checkpoint:
  file: {file}
  sha256: {digest}

control:
  action: joint_position_offset
  scale: 0.25
  clip: 4.8
  delay_steps: 1
  kp: 20
  kd: 0.5

command: {{source: waypoint, speed: 0.8}}

observations:  # 332 numbers, in this order
  proprio: {{sensor: proprio, layout: parkour53}}
  scandots: {{sensor: scandots}}
  last_output: {{sensor: proprio, terms: [last_output]}}
  history:  # earlier frames without delta_yaw, speed and the mask
    sensor: proprio
    layout: parkour53
    select: ["0:5", "13:53"]
    history: {{steps: 3, order: newest_first, current: false}}
"""


def export_teacher(actor: Actor, folder: Path, *, name: str) -> None:
    """Write the policy's folder: weights first, then the card that says their digest.

    Raises:
        StoreError: it cannot be written.
    """
    weights = write_actor(actor)
    named = re.sub(r"[^A-Za-z0-9_.-]", "-", name).lstrip("_.-")[:64] or "teacher"
    card = _CARD.format(name=named, file=_CHECKPOINT, digest=sha256(weights).hexdigest())
    with atomic_path(folder / _CHECKPOINT) as temporary:
        temporary.write_bytes(weights)
    with atomic_path(folder / CARD_FILE) as temporary:
        temporary.write_text(card, encoding="utf-8")


def export_checkpoint(folder: Path, number: int | None, out: Path) -> Path:
    """Write the policy of a training's checkpoint; return the checkpoint's file.

    Args:
        folder: of the training.
        number: of the kept checkpoint; None = the newest state.
        out: the policy's folder.

    Raises:
        UsageError: there is no such checkpoint.
        StoreError: it cannot be read, or the policy not written.
    """
    path = TrainFolder.resume(folder).checkpoint(number)
    actor = Actor()
    load_network(actor, read_state(path), "actor", path)
    export_teacher(actor, out, name=out.name)
    return path
