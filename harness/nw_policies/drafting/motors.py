"""Motors of a training beyond servos: what its configuration says, as groups of a card.

Isaac Lab and mjlab name a class and its numbers for each group of joints. What a card has not stays
a note: limits that depend on the angle, a strength or a delay that is drawn for each episode.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, cast

from nw_base.files.inside import what_is
from nw_policies.cards.motors import MOST_STEPS
from nw_policies.drafting.fields import Fields, numbers_of
from nw_policies.drafting.notation import CHECK, flow, plain
from nw_policies.drafting.patterns import Patterns

Group = Mapping[str, Any]
"""Keys of a card's group of motors, with their values."""
TOLD_LATE = "its motors were told {:g} to {:g} physics steps late"
_SERVOS = re.compile(r"Implicit|IdealPD|BuiltinPosition|XmlPosition", re.IGNORECASE)
_KNOWN = re.compile(
    "DCMotor|DelayedPDActuator|RemotizedPDActuator|ActuatorNetMLP|ActuatorNetLSTM", re.IGNORECASE
)
"""Classes of which a card has all but what is drawn for each episode."""
_NEWTONS = ("dynamic_friction", "viscous_friction")
"""Keys of Isaac Lab with Isaac Sim 5: `friction` is a torque there, N m. Before, it was a share of
the force that the joint transmits."""
_PUBLISHED = {"unitree_go1.pt": {"pos_scale": -1.0, "history": [0, 1, 2]}}
"""What networks of walk-these-ways' form take, where only their file is named."""


def motor_groups(
    groups: Sequence[Fields], patterns: Patterns, *, physics_rate: float | None
) -> tuple[tuple[Group, ...], tuple[str, ...]]:
    """Return groups of a card, and sentences of what else its author must know.

    Args:
        groups: of motors, as a training's configuration has them.
        patterns: of the robot's joints.
        physics_rate: of the training, Hz; a card's delay counts in steps of 200 Hz.
    """
    found: list[Group] = []
    notes: dict[str, None] = {}
    for group in groups:
        kind = re.split(r"[.:]", str(group.get("class_type") or ""))[-1].removesuffix("Cfg")
        own, late = _own_groups(group, patterns, physics_rate)
        found += own
        if kind and not _SERVOS.search(kind) and not (_KNOWN.fullmatch(kind) and own):
            has = "its delay and torque-speed curve alone" if own else "servos"
            notes[f"its motors are of the kind {kind}: the card has {has}"] = None
        notes |= dict.fromkeys(late)
        friction = group.get("friction")
        if friction and not any(key in group for key in _NEWTONS):
            notes[f"its joints have friction {friction}: see `friction_loss`"] = None
        moving = group.get("dynamic_friction")
        if moving is not None and moving != friction:
            notes[f"its joints had friction {moving} when they moved: a card has one"] = None
        strength = group.numbers("motor_strength")
        if strength not in ((), (1.0,), (1.0, 1.0)):
            low, high = min(strength), max(strength)
            said = f"a strength that was drawn from {low:g} to {high:g}: the card has 1"
            notes[f"its motors had {said}"] = None
        if limits := _limits(group):
            low, middle, high = limits
            notes[
                f"the torque limit of {', '.join(patterns.names_of(group))} depends on the angle, "
                f"{low:g} to {high:g} N m: the card has the middle, {middle:g}"
            ] = None
    return tuple(found), tuple(notes)


def with_limits(groups: Sequence[Fields]) -> list[Fields]:
    """Return groups with the torque limits of their joints as `effort_limit`.

    Those whose limit depends on the angle have the middle; implicit motors of Isaac Lab may have
    the solver's limit alone, which is theirs.
    """
    found: list[Fields] = []
    for group in groups:
        limit: Any = group.get("effort_limit_sim") if group.get("effort_limit") is None else None
        if limits := _limits(group):
            limit = limits[1]
        found.append(group if limit is None else Fields({**group, "effort_limit": limit}))
    return found


def _limits(group: Fields) -> tuple[float, float, float] | None:
    """Return the least limit, the middle and the largest of `joint_parameter_lookup`, N m.

    Its rows are an angle, a ratio of transmission and the torque (Isaac Lab's RemotizedPD).
    """
    rows = group.get("joint_parameter_lookup")
    listed = cast("list[Any]", rows) if isinstance(rows, list) else []
    torques = [row[2] for row in map(numbers_of, listed) if len(row) == 3]
    if not torques or len(torques) < len(listed) or min(torques) <= 0.0:
        return None
    return min(torques), (min(torques) + max(torques)) / 2.0, max(torques)


def _own_groups(
    group: Fields, patterns: Patterns, physics_rate: float | None
) -> tuple[list[Group], list[str]]:
    """Return a card's groups of one group of a training, and notes of its delay."""
    names = patterns.names_of(group)
    if not names:
        return [], []
    delay, late = _delay(group, physics_rate)
    shared = {"delay": delay} if delay else {}
    curves = _curves(group, patterns)
    name = group.get("network_file")
    if isinstance(name, str) and name:
        kind = {"kind": "network", **_network(group, name)}
        curves = curves or [(names, {})]
    elif curves:
        kind = {"kind": "dc"}
    else:
        kind = {"kind": "pd"}
        curves = [(names, {})] if delay else []
    parts = [(_written(own, patterns.names), curve) for own, curve in curves]
    return [{"joints": own, **kind, **curve, **shared} for own, curve in parts], late


def _delay(group: Fields, physics_rate: float | None) -> tuple[int, list[str]]:
    """Return the middle of a group's delays, in physics steps of a card, and a note of it."""
    most = group.number("max_delay") or 0.0
    least = group.number("min_delay") if "min_delay" in group else most
    least = min(least or 0.0, most)
    note = f"{TOLD_LATE.format(least, most)}: the card has the middle"
    return late_steps((least + most) / 2.0, physics_rate), [note] if most > least else []


def late_steps(steps: float, physics_rate: float | None) -> int:
    """Return a delay in a card's physics steps, of 200 Hz, for one in those of a training."""
    return round(min(max(steps * 200.0 / (physics_rate or 200.0), 0.0), MOST_STEPS))


def _curves(group: Fields, patterns: Patterns) -> list[tuple[Sequence[str], dict[str, float]]]:
    """Return joints and torque-speed curve of each part of a group that has one."""
    if "saturation_effort" not in group:
        return []
    stall = patterns.of_group(group, "saturation_effort")
    speed = patterns.of_group(group, "velocity_limit")
    by_curve: dict[tuple[float, float], list[str]] = {}
    for name, torque in stall.items():
        fastest = speed[name]
        if torque and fastest and torque > 0.0 and fastest > 0.0:
            by_curve.setdefault((torque, fastest), []).append(name)
    return [
        (names, {"saturation_torque": torque, "no_load_speed": fastest})
        for (torque, fastest), names in by_curve.items()
    ]


def _network(group: Fields, name: str) -> dict[str, Any]:
    own: dict[str, Any] = {"file": _file_of(name)}
    steps = [int(step) for step in numbers_of(group.get("input_idx"))]
    if steps and 0 <= min(steps) <= max(steps) <= MOST_STEPS:
        own["history"] = steps
    if group.get("input_order") == "vel_pos":
        own["order"] = "vel_pos"
    for key in ("pos_scale", "vel_scale", "torque_scale"):
        if (value := group.number(key)) is not None and value != 1.0:
            own[key] = value
    return own


def _file_of(path: str) -> str:
    """Return the name of a file as a card can have it unquoted."""
    name = PurePosixPath(path.replace("\\", "/")).name
    return re.sub(r"[^\w.-]", "_", name, flags=re.ASCII)[:100]


def named_network(name: str, *, delay: int) -> Group:
    """Return the group of all motors for a file that a configuration names without numbers."""
    own = {"joints": "*", "kind": "network", "file": (file := _file_of(name))}
    own |= _PUBLISHED.get(file, {})
    return {**own, "delay": delay} if delay else own


def _written(names: Sequence[str], every: Sequence[str]) -> Any:
    """Return joints as a card names them: all, by type where that says it, else one by one."""
    if set(names) == set(every):
        return "*"
    kinds = dict.fromkeys(name.rpartition("_")[2] for name in names)
    whole = [n for n in every if n.rpartition("_")[2] in kinds]
    return list(kinds) if set(whole) == set(names) else list(names)


def motor_lines(groups: Sequence[Group], folder: Path, source: str) -> list[str]:
    """Return the lines of a card; groups whose network is not there are left as comments.

    Args:
        groups: from `motor_groups`.
        folder: of the card.
        source: the file that names them, as a comment has it.
    """
    lines: list[str] = []
    absent: list[str] = []
    for group in groups:
        file = group.get("file")
        if file is None or what_is(folder / str(file)) == "file":
            lines.append(f"    - {flow(dict(group))}")
        else:
            note = f"{file} is not in {plain(folder.name) or 'the folder'}: put it there"
            absent += [f"  {CHECK} {note}, and take these two lines", "  # motors:"]
            absent += [f"  #   - {flow(dict(group))}"]
    return [*([f"  motors:{source}", *lines] if lines else []), *absent]
