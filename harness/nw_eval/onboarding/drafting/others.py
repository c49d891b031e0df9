"""The other published layouts that a checkpoint may have, as comments of a draft."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.onboarding.drafting.motors import published
from nw_eval.onboarding.drafting.vectors import ObservationDraft
from nw_eval.onboarding.reading.text import CHECK
from nw_eval.robots import RobotSpec


def other_layouts(parts: Sequence[ObservationDraft], robot: RobotSpec) -> list[str]:
    """Return lines that say each of them in full; none where there is but one.

    Args:
        parts: the observations of the draft.
        robot: whose joints they order.
    """
    drafted = {part.fits[0][0].name for part in parts if part.fits}
    others = {frame.name: frame for part in parts for frame, _ in part.fits[1:]}
    others = {name: frame for name, frame in others.items() if name not in drafted}
    if not others:
        return []
    command = f"nw-eval policies init CHECKPOINT --robot {robot.name} --layout NAME --out NAME.yaml"
    lines = [
        "",
        f"# This card is of {' and '.join(sorted(drafted))}. Other published layouts of its sizes:",
        f"# {', '.join(others)}. To write the card of one, whose lines stand below:",
        f"#     {command}",
        "# `nw-eval policies check` tells which of them walks.",
    ]
    for name, frame in others.items():
        lines += ["#", f"# {name} ({frame.source}): {frame.traits}", "#   control:"]
        values = published(frame, robot)
        lines += [f"#     {key}: {value}" for key, value in values.items()]
        lines.append("#   observations:")
        for part in parts:
            if name in part.ways:
                lines.append(f"#     {part.name}:")
                lines += [f"#       {line}" for line in map(_uncommented, part.ways[name]) if line]
    return lines


def _uncommented(line: str) -> str:
    return line.partition(CHECK)[0].rstrip()
