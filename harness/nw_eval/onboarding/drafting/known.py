"""What the published networks see, as a card writes it."""

from __future__ import annotations

from nw_eval.onboarding.drafting.vectors import zeros_note
from nw_eval.onboarding.reading.facts import CheckpointFacts
from nw_eval.onboarding.reading.text import CHECK, RATE_LINE

_LUCIDSIM = """\
observations:
  proprio: {sensor: proprio, layout: parkour53}
  rgb:
    sensor: splat_rgb
    camera: ego
    width: 80
    height: 45
    sampling: published
    stack: 7
    axes: chw
    dtype: float32
    mean: 127.5
    std: 255

inputs: {proprio: [proprio], frames: [rgb]}"""

_BODY = """\
observations:
  proprio: {sensor: proprio, layout: parkour53}
  history:  # the ten frames before the present one, without their heading
    sensor: proprio
    layout: parkour53
    history: {steps: 10, current: false, zero: ["6:8"]}
"""
_EXPERT = """\
  scandots: {sensor: scandots}

inputs: {proprio: [proprio], scandots: [scandots], history: [history]}"""
_STUDENT = """\
  depth:
    sensor: depth
    camera: ego
    width: 80
    height: 45
    rate: 10
    wrap:  # CHECK: near and far of the training, here 0.28 and 2 m
      - {wrapper: clip, limits: [0.28, 2.0]}
      - {wrapper: normalize, mean: 0.28, std: 1.72}
      - {wrapper: scale, offset: -0.5}

inputs: {proprio: [proprio], depth: [depth], history: [history]}
options: {depth_every: 5, steer_by_depth: true}"""


def known_observations(facts: CheckpointFacts) -> list[str] | None:
    """Return the lines of a card for a known network; None for one whose inputs must be guessed."""
    match facts.adapter:
        case "lucidsim":
            return [*_LUCIDSIM.splitlines()]
        case "extreme-parkour":
            student = any(t.name.startswith("depth_encoder_state_dict.") for t in facts.tensors)
            note = ["# The file holds the expert too: feed it `scandots` in place of `depth`."]
            text = _BODY + (_STUDENT if student else _EXPERT)
            return [*(note if student else []), *text.splitlines()]
        case "act":
            return _act(facts)
        case _:
            return None


def _act(facts: CheckpointFacts) -> list[str]:
    shapes = {tensor.name.removeprefix("model."): tensor.shape for tensor in facts.tensors}
    size = shapes["encoder_robot_state_input_proj.weight"][1]
    chunk = shapes["decoder_pos_embed.weight"][0]
    images = any(name.startswith("backbone.") for name in shapes)
    proprio = (
        "layout: parkour53"
        if size == 53
        else f"terms: [{{term: constant, value: 0, width: {size}}}]"
    )
    note = f"{CHECK} {size} numbers" if size == 53 else zeros_note(size)
    lines = [
        "# CHECK: the weights do not say how many attention heads share them",
        f"options: {{heads: 8, ensemble: 0.01, query_every: 1}}  # a chunk has {chunk} actions",
        "",
        "observations:",
        f"  proprio: {{sensor: proprio, {proprio}}}  {note}",
    ]
    if images:
        lines += [
            "  rgb:",
            "    sensor: splat_rgb",
            "    camera: ego",
            "    width: 320  # CHECK: the size of the training images",
            "    height: 180",
            f"    {RATE_LINE}",
            "    axes: chw",
            "    dtype: float32",
            "    mean: 0  # CHECK: (byte - mean) / std",
            "    std: 255",
        ]
    inputs = "proprio: [proprio]" + (", images: [rgb]" if images else "")
    return [*lines, "", f"inputs: {{{inputs}}}"]
