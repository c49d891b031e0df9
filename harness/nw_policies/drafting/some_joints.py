"""Checkpoints that drive some of a robot's joints: which, and what a card says of the others.

What a file names is known. Where it says a number of joints alone, they are taken for those of the
legs, the waist with them where they are as many, or for the first ones of the robot.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import fields, replace

from nw_policies.cards.joints import short_name
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.exporters import ExporterMetadata
from nw_policies.drafting.notation import CHECK, plain
from nw_policies.drafting.patterns import reordered
from nw_policies.drafting.trained import trained_network
from nw_scenes.robots import RobotSpec

_FEWEST = 6
"""Joints of what walks."""
_LEG, _WAIST = r"hip|thigh|knee|calf|ankle|leg|foot|toe|haa|hfe|kfe|abad", r"waist|torso"
_PER_JOINT = (
    *("joints", "default_pose", "joint_ranges", "kp", "joint_damping", "torque_limits"),
    *("armature", "friction_loss", "follows"),
)


def driven_joints(
    facts: CheckpointFacts, known: ExporterMetadata | None, robot: RobotSpec
) -> tuple[str, ...]:
    """Return the joints that a checkpoint drives, in its order; none if it may drive all.

    Args:
        facts: what the checkpoint says.
        known: what it and files beside it name.
        robot: that has more joints.
    """
    own = {short_name(joint): joint for joint in robot.joints}
    names = [short_name(name) for name in (known.joint_names if known else ())]
    count = known.joint_count if known else 0
    if names and not (set(names) == set(own) and 0 < count < len(own)):
        fits = set(names) < set(own) and len(set(names)) == len(names) >= _FEWEST
        return tuple(own[name] for name in names) if fits else ()
    sizes = {output.shape[-1] for output in facts.outputs if output.shape}
    sizes = sizes or _outputs_of_weights(facts, len(own))
    counts = {count} if count else {size for size in sizes if size}
    if len(counts) != 1 or not _FEWEST <= (wanted := counts.pop()) < len(own):
        return ()
    legs = [name for name in own if re.search(_LEG, name, re.IGNORECASE)]
    lower = [name for name in own if re.search(f"{_LEG}|{_WAIST}", name, re.IGNORECASE)]
    taken = next((each for each in (legs, lower) if len(each) == wanted), list(own)[:wanted])
    return tuple(own[name] for name in taken)


def _outputs_of_weights(facts: CheckpointFacts, joints: int) -> set[int | None]:
    """Return how many joints a training's network drives, where that is fewer than a robot has."""
    if facts.adapter is not None or trained_network(facts, joints) is not None:
        return set()
    networks = {count: trained_network(facts, count) for count in range(_FEWEST, joints)}
    return {
        count
        for count, network in networks.items()
        if network is not None and network.is_known and network.layers[-1].outputs == count
    }


def known_of(known: ExporterMetadata | None, driven: Sequence[str]) -> ExporterMetadata | None:
    """Return what files say of the driven joints, where they list numbers of all joints."""
    if known is None or not known.joint_names or len(known.joint_names) == len(driven):
        return known
    names, wanted = known.joint_names, tuple(map(short_name, driven))
    lists = ("joint_stiffness", "joint_damping", "default_joint_pos", "torque_limits", "armature")
    lists = (*lists, "friction_loss", "viscous_friction", "action_scale")
    of_all = {name: getattr(known, name) for name in lists}
    part = {
        name: reordered(values, names, wanted)
        for name, values in of_all.items()
        if len(values) == len(names)
    }
    return replace(known, joint_names=wanted, guessed_order=True, **part)


def known_of_all(
    said: ExporterMetadata | None, driven: ExporterMetadata | None, robot: RobotSpec
) -> ExporterMetadata | None:
    """Return what files say of all joints, held ones too; None where they do not list them.

    Args:
        said: of all joints.
        driven: from `known_of`.
        robot: that has more joints.
    """
    if said is None or driven is None or len(said.joint_names) != len(robot.joints):
        return None
    return replace(said, action_scale=driven.action_scale, sources=driven.sources)


def of_joints(robot: RobotSpec, joints: Sequence[str]) -> RobotSpec:
    """Return what a robot says of some of its joints, in their order."""
    order = [robot.joints.index(joint) for joint in joints]
    values = {f.name: getattr(robot, f.name) for f in fields(robot) if f.name in _PER_JOINT}
    part = {name: tuple(row[i] for i in order) if row else () for name, row in values.items()}
    return replace(robot, **part)


def held_lines(
    driven: Sequence[str], robot: RobotSpec, known: ExporterMetadata | None
) -> list[str]:
    """Return the line of a card that says which joints of a robot are held; none if none are.

    Args:
        driven: from `driven_joints`.
        robot: that has more joints.
        known: what files name, of all joints where they list them.
    """
    if not driven:
        return []
    names = tuple(map(short_name, known.joint_names if known else ()))
    held = [short_name(joint) for joint in robot.joints if joint not in driven]
    is_named = 0 < len(names) == len(driven)
    guess = "" if is_named else "the driven joints are guessed from their number; "
    where = f"at the {robot.name}'s own pose"
    if known and len(names) == len(known.default_joint_pos) == len(robot.joints):
        where = "at the pose above"
    listed = f"[{', '.join(map(plain, held))}]"
    note = "`joint_pos` and `joint_vel` leave them out but with `leave_out: []`"
    return [f"  held: {listed}  {CHECK} {guess}{where}; {note}"]


def commanded_lines(known: ExporterMetadata | None) -> list[str]:
    """Return the line of a card that says which driven joints a command moves; none if none."""
    if known is None or not known.commanded:
        return []
    return [f"  commanded: [{', '.join(map(plain, known.commanded))}]"]
