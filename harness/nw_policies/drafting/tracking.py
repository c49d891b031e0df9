"""What exporters and trainings say of the motion that a policy tracks, as lines of a card.

Names are those of HybridRobotics/whole_body_tracking, mjlab, unitree_rl_lab, rl_sar, holosoma, ASAP
and PBHC.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from nw_base.files.inside import what_is
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.exporters import ExporterMetadata
from nw_policies.drafting.notation import CHECK, plain, quoted
from nw_scenes.robots import RobotSpec

MOTION_COMMAND = "motion_command"
"""The term that shows joint positions and velocities of the motion."""
REFERENCE_TERM_OF: dict[str, tuple[str, int | None]] = {
    MOTION_COMMAND: ("joint_positions+joint_velocities", None),
    "motion_joint_pos": ("joint_positions", None),
    "motion_joint_vel": ("joint_velocities", None),
    **dict.fromkeys(("motion_anchor_pos_b", "motion_ref_pos_b"), ("anchor_position", 3)),
    **dict.fromkeys(("motion_anchor_ori_b", "motion_ref_ori_b"), ("anchor_orientation_6d", 6)),
    **dict.fromkeys(("ref_motion_phase", "motion_phase"), ("phase", 1)),
}
"""Names of terms, with ours and their size, as `TERM_OF` has them."""
TIME_STEP = "time_step"
"""The input of checkpoints that hold the motion: the number of the frame."""
TABLES = frozenset(
    {"joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w",
     "ref_pos_xyz", "ref_quat_xyzw"}
)  # fmt: skip
"""Outputs of such checkpoints that are no actions."""
AHEAD = "ahead: [1]  # trainings show the frame that the next step is to reach"
_TORSO = "torso_link"
_SUFFIXES = (".npz", ".csv", ".pkl")
_MOST = 200


def motions_beside(checkpoint: Path, folder: Path) -> tuple[str, ...]:
    """Return the files near a checkpoint that may be its motion, as paths below a card's folder.

    They lie beside it, in folders there, or in `params` above, as unitree_rl_lab has them. What a
    training reads, an .npz, comes first.
    """
    near, root = checkpoint.absolute().parent, folder.resolve()
    places = [near, near.parent / "params"]
    places += [path for path in sorted(near.glob("*")) if what_is(path) == "folder"]
    found = dict.fromkeys(
        path.resolve()
        for place in places[:_MOST]
        for path in sorted(place.glob("*"))[:_MOST]
        if path.suffix in _SUFFIXES and what_is(path) == "file"
    )
    below = [path for path in found if path.is_relative_to(root)]
    below.sort(key=lambda path: _SUFFIXES.index(path.suffix))
    return tuple(path.relative_to(root).as_posix() for path in below)


def tracks(facts: CheckpointFacts, known: ExporterMetadata, words: Collection[str]) -> bool:
    """Return whether a policy tracks a motion, by its inputs, its metadata or its terms."""
    held = any(array.name == TIME_STEP for array in facts.inputs)
    return held or bool(known.anchor) or not set(words).isdisjoint(REFERENCE_TERM_OF)


def reference_lines(
    facts: CheckpointFacts,
    known: ExporterMetadata,
    robot: RobotSpec,
    motions: Sequence[str],
    own: str,
) -> list[str]:
    """Return the lines of `reference`.

    Args:
        facts: of the checkpoint.
        known: what is known of it.
        robot: that the policy drives.
        motions: from `motions_beside`.
        own: the checkpoint's path below the card's folder.
    """
    named = Path(known.motion_file.replace("\\", "/")).name
    motion = next((path for path in motions if Path(path).name == named), (*motions, "")[0])
    outputs = {array.name for array in facts.outputs}
    held = any(array.name == TIME_STEP for array in facts.inputs) and "joint_pos" in outputs
    lines = ["reference:"]
    if held:
        lines.append(f"  file: {quoted(own)}  # it holds its motion")
    elif motion:
        lines.append(f"  file: {quoted(motion)}  {CHECK} the motion that it was trained on")
    else:
        name = plain(named) or "motion.npz"
        lines.append(f"  file: {quoted(name)}  {CHECK} copy the motion beside this card")
    if known.motion_joints and not held:
        lines.append(f"  joints: [{', '.join(map(plain, known.motion_joints))}]")
    if not held and not motion.endswith((".npz", ".pkl")):
        rate = re.search(r"(\d+)_?(hz|fps)", motion, re.IGNORECASE)
        if rate:
            lines.append(f"  rate: {int(rate[1])}  {CHECK} frames a second, by the file's name")
        elif motion:
            lines.append(f"  rate: 30  {CHECK} frames a second; LAFAN1 has 30")
    anchor = known.anchor or (_TORSO if _TORSO in robot.bodies else robot.root)
    note = "" if known.anchor else f"  {CHECK} the body whose pose it compares"
    lines.append(f"  anchor: {plain(anchor)}{note or _source(known, 'anchor')}")
    if known.bodies:
        bodies = ", ".join(plain(name) for name in known.bodies)
        lines.append(f"  bodies: [{bodies}]{_source(known, 'bodies')}")
    else:
        lines.append(f"  # bodies: all  {CHECK} the bodies whose errors the training counts")
    return lines


def _source(known: ExporterMetadata, field: str) -> str:
    return f"  # {known.sources[field]}" if field in known.sources else ""
