"""`nw-eval robots`: which there are, what one is, if it stands, a first robot.yaml, fetching."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned, fetched_lines
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import ListedRobot, RobotDraft
    from nw_scenes.hub.reference import Fetched
    from nw_sim.probe.robot_check import CheckedRobot, RobotEye, RobotJoint, RobotSummary

FALLS = 1
"""Exit code of a robot that does not stand."""


@verb_of("list_robots")
class List(Printed, Verb):
    """List the available robots: built in, in ./robots, and of plugins."""

    def show(self, result: Sequence[ListedRobot]) -> str:
        return robot_table(result)


@verb_of("show_robot")
class Show(Printed, Verb):
    """Show a robot: joints, motors, feet, camera, mass, and which line defines each."""

    def show(self, result: RobotSummary) -> str:
        return robot_page(result)


@verb_of("init_robot")
class Init(Verb):
    """Derive a first robot.yaml from a model file, drop the robot for 2 s, and write it.

    The file is written beside the model, or in the folder above that has model and meshes. Each
    line names its source; `CHECK` marks a guess. --out names a folder here, and a file in
    `policies init`.
    """

    def show(self, result: RobotDraft) -> str:
        ending = "it stands" if result.stands else "it does not stand"
        return f"{result.text}\n{result.file}: {plural(result.to_check, 'line')} to check; {ending}"


@verb_of("check_robot")
class Check(Printed, Verb):
    """Let a robot stand for 2 s with its pose and gains. Exit code 1 if it falls.

    Shows its feet, motors, self-contacts and height, and draws it from outside and through its
    camera. A robot with fewer than three feet is held upright.
    """

    out = Path("robot.png")

    def show(self, result: CheckedRobot) -> str:
        return f"{check_page(result)}\n{self.out}"

    def code(self, result: CheckedRobot) -> int:
        return 0 if result.stands else FALLS


@verb_of("fetch_robot", named={"reference": "robot"})
class Fetch(Verb):
    """Download a robot's current version from its hub or from MuJoCo Menagerie.

    Runs then use this copy and need no network. Nothing is executed. Hub robots need the extra
    `hub`, Menagerie robots the extra `robots`.
    """

    def show(self, result: Fetched) -> str:
        return fetched_lines(result)


def robot_table(robots: Sequence[ListedRobot]) -> str:
    """Return a line for each robot: name, joints, feet, mass, height, where it is from."""
    rows = [("robot", "joints", "feet", "mass", "height", "from")]
    for each in robots:
        if each.problem is not None:
            rows.append((clean(each.name), "?", "?", "?", "?", clean(each.problem)))
            continue
        numbers = f"{each.joints}", f"{each.feet}", f"{each.mass:.1f} kg", f"{each.height:.2f} m"
        rows.append((clean(each.name), *numbers, clean(each.place)))
    return "\n".join(aligned(rows, right=range(1, 5)))


def robot_page(robot: RobotSummary) -> str:
    """Return all that is known of a robot, and which line says what."""
    low = "no limit" if robot.fell_height is None else f"lower than {robot.fell_height:.2f} m"
    said = robot.sources
    facts = [
        ("name", robot.name, ""),
        ("reference", robot.reference, ""),
        ("from", robot.place, ""),
        ("mass", f"{robot.mass:.2f} kg in {plural(robot.bodies, 'body', 'bodies')}", ""),
        ("root", robot.root, said["root"]),
        ("feet", ", ".join(robot.feet), said["feet"]),
        ("pose", "below", said["pose"]),
        ("spawn", f"root {robot.spawn_height:.3f} m above the ground", said["spawn_height"]),
        ("body", ", ".join(robot.body) or "none", said["body"]),
        ("collided", f"{robot.collided_force:.1f} N on one of them", said["collided"]),
        ("fell", f"tilt over {robot.fell_tilt:.2f} rad; {low}", said["fell"]),
        *(("eye", f"{eye.name}, {_eye(eye)}", said["eye"]) for eye in robot.eyes),
    ]
    joints = [
        ("joint", "pose", "range, rad", "kp", "kd", "torque", "armature", "friction", "from"),
        *map(_joint, robot.joints),
    ]
    rows = [(key, clean(value), clean(source)) for key, value, source in facts]
    lines = [*aligned(rows), "", *aligned(joints, right={1, 3, 4, 5, 6, 7})]
    return "\n".join(line.rstrip() for line in lines)


def _joint(joint: RobotJoint) -> tuple[str, ...]:
    ends = ["none" if end is None else f"{end:z.3f}" for end in (joint.low, joint.high)]
    motor = joint.kp, joint.kd, joint.torque, joint.armature, joint.friction
    values = (f"{value:zg}" for value in motor)
    return (
        clean(joint.joint),
        f"{joint.pose:z.3f}",
        " to ".join(ends),
        *values,
        clean(joint.source),
    )


def _eye(eye: RobotEye) -> str:
    from nw_sim.probe.robot_check import eye_words

    return eye_words(eye)


def check_page(robot: CheckedRobot) -> str:
    """Return what became of a robot that was put down, and what is odd."""
    weight = sum(part.force for part in (*robot.feet, *robot.others)) or 1.0
    feet = [
        ("foot", "force", "share"),
        *((clean(p.foot), f"{p.force:.0f} N", f"{p.force / weight:.0%}") for p in robot.feet),
        *(
            (f"{clean(p.foot)} (no foot)", f"{p.force:.0f} N", f"{p.force / weight:.0%}")
            for p in robot.others
        ),
    ]
    shares = [
        ("joint", "torque, of its largest"),
        *((clean(name), f"{share:.0%}") for name, share in robot.torque_shares.items()),
    ]
    ending = _ending(robot, weight)
    held = ", held upright: it has fewer than three feet" if robot.held else ""
    tilted = f", tilt {math.degrees(robot.tilt):.0f} degrees{held}"
    lines = [
        f"{robot.name}: {ending}; {robot.mass:.2f} kg, of {clean(robot.place)}",
        f"base height {robot.spawn_height:.3f} m at start, {robot.height:.3f} m after 2 s{tilted}",
        f"eye {_eye(robot.eye)}",
        "",
        *aligned(feet, right={1, 2}),
        "",
        *aligned(shares, right={1}),
        "",
        *(f"note: {clean(note)}" for note in robot.notes),
        f"{robot.name}: {ending}",
    ]
    return "\n".join(lines)


def _ending(robot: CheckedRobot, weight: float) -> str:
    """Return whether it stands, and on what else than its feet."""
    if not robot.stands:
        return "it does not stand"
    if not robot.carriers:
        return "it stands"
    share = sum(part.force for part in robot.others if part.foot in robot.carriers) / weight
    *most, last = map(clean, robot.carriers)
    who = f"{', '.join(most)} and {last} carry" if most else f"{last} carries"
    return f"it stands, but {who} {share:.0%} of its weight"
