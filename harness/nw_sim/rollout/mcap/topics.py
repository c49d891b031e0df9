"""The topics of a log: docs/reference/mcap.md shows them, and a test compares them with a log.

Frames are those of `/tf`: `world`, each body of the robot, and `camera/<camera>` with OpenCV's axes
(x right, y down, z ahead). `heading` is the trunk's origin, level, turned by the trunk's yaw.
"""

from __future__ import annotations

from dataclasses import dataclass

MOTION = "motion"
"""The attachment with the motion that is tracked: `nw_sim.rollout.referenced.unpacked_motion`."""

MOTORS = "motors"
"""The attachment with the networks of motors: `nw_sim.rollout.driven.packed_programs`."""

ELEMENTS = "nw.elements"
"""The record of texts that names numbers: by topic, or topic and field, with commas between."""

SHUTTERS = "nw.shutters"
"""The record of texts that says, by camera, how long it takes: JSON, `readout` and `exposure`, s.
There is one where a camera takes time."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One row of the table; what stands in angle brackets differs from log to log."""

    name: str
    schema: str
    rate: str
    holds: str
    frame: str = ""


_STEP = "50 Hz"
_NEW = "when new"
_ONCE = "once"

TOPICS = (
    Topic(
        name="/tf",
        schema="foxglove.FrameTransforms",
        rate=_STEP,
        holds="every body of the robot, the cameras whose pictures are logged, and `prop/<name>` "
        "of each prop of the scene; m, quaternions",
        frame="world",
    ),
    Topic(
        name="/robot/odom",
        schema="foxglove.PoseInFrame",
        rate=_STEP,
        holds="the trunk's pose; m, quaternion",
        frame="world",
    ),
    Topic(
        name="/robot/twist",
        schema="nw.Twist",
        rate=_STEP,
        holds="velocity of the trunk's origin, m/s, and angular velocity, rad/s",
        frame="trunk",
    ),
    Topic(
        name="/robot/joints",
        schema="foxglove.JointStates",
        rate=_STEP,
        holds="angle, rad, velocity, rad/s, and torque, N m, of each joint",
    ),
    Topic(
        name="/robot/command",
        schema="nw.Command",
        rate=_STEP,
        holds="what the card's `command` asks for: `forward` and `left`, m/s, `yaw_rate`, rad/s; "
        "`heading_error` to the next waypoint, rad, positive to the left",
        frame="heading",
    ),
    Topic(
        name="/robot/path",
        schema="foxglove.PointCloud",
        rate="2 Hz",
        holds="where the trunk's origin has been so far, a point at 10 Hz; m",
        frame="world",
    ),
    Topic(
        name="/observation/<observation>",
        schema="nw.Observation",
        rate=_NEW,
        holds="numbers as the policy was given them, after latency, noise and wrappers, in single "
        "precision, bit for bit: `terms` by the card's names; more than 4,096 numbers only where "
        "images are kept",
    ),
    Topic(
        name="/camera/<camera>",
        schema="foxglove.CompressedImage",
        rate=_NEW,
        holds="the policy's first photograph from that camera, the newest of a stack, as JPEG; "
        "if it sees no picture at all, one for people at 10 Hz",
        frame="camera/<camera>",
    ),
    Topic(
        name="/camera/<camera>/<observation>",
        schema="foxglove.CompressedImage",
        rate=_NEW,
        holds="every other photograph; classes as PNG whose palette has their colours",
        frame="camera/<camera>",
    ),
    Topic(
        name="/camera/<camera>/<observation>",
        schema="foxglove.RawImage",
        rate=_NEW,
        holds="depth in metres as `16UC1`: whole mm, 0 for none and beyond 65.5 m; other numbers "
        "as `32FC1`, bit for bit",
        frame="camera/<camera>",
    ),
    Topic(
        name="<picture>/calib",
        schema="foxglove.CameraCalibration",
        rate=_ONCE,
        holds="the camera of those pictures, after `crop` and `resize`; pixels",
        frame="camera/<camera>",
    ),
    Topic(
        name="/scene",
        schema="foxglove.SceneUpdate",
        rate=_ONCE,
        holds="scene and waypoints, m, and the robot's parts, each in its body's frame",
        frame="world",
    ),
    Topic(
        name="/waypoints",
        schema="foxglove.SceneUpdate",
        rate="at the start, and when one is reached",
        holds="all waypoints: orange, or green once they are reached",
        frame="world",
    ),
    Topic(
        name="/points/place",
        schema="foxglove.PointCloud",
        rate=_ONCE,
        holds="3,000 points of the scene, for viewers that draw no `SceneUpdate`; m",
        frame="world",
    ),
    Topic(
        name="/points/robot/<body>",
        schema="foxglove.PointCloud",
        rate=_ONCE,
        holds="corners of the body's parts, for the same viewers; m",
        frame="<body>",
    ),
    Topic(
        name="/points/trail",
        schema="foxglove.PointCloud",
        rate="as `/waypoints`",
        holds="dots along the course, green as far as it is done; m",
        frame="world",
    ),
    Topic(
        name="/points/waypoints",
        schema="foxglove.PointCloud",
        rate="as `/waypoints`",
        holds="a ring around each waypoint, green once it is reached; m",
        frame="world",
    ),
    Topic(
        name="/nw/policy",
        schema="nw.PolicyStep",
        rate=_STEP,
        holds="`action`, what the policy said; `applied`, what it said when the delay began; "
        "`targets`, rad, or N m; SHA-256 of its observations",
    ),
    Topic(
        name="/scores",
        schema="nw.Observation",
        rate="every 20 control steps, and at the end",
        holds="where the suite measures [scores](scores.md#scores-of-a-log): built-in ones of the "
        "trial until then, a term each, in its unit, single precision; at the end all of its row",
    ),
    Topic(
        name="/nw/state",
        schema="nw.SimState",
        rate="5 Hz (2 Hz above 32 KiB), at waypoints, first contacts and the end",
        holds="all that the trial needs to go on from there, bit for bit",
    ),
    Topic(
        name="/nw/event",
        schema="nw.Event",
        rate="when it happens",
        holds="start, waypoint, contact, coverage, end, error; for programs",
    ),
    Topic(name="/log", schema="foxglove.Log", rate="as `/nw/event`", holds="the same in words"),
)
"""Every topic, in the order of the page."""


def topics_table() -> str:
    """Return the topics as the Markdown table of docs/reference/mcap.md."""
    lines = ["| topic | schema | rate | what, in which unit | frame |", "|---|---|---|---|---|"]
    for topic in TOPICS:
        frame = f"`{topic.frame}`" if topic.frame else ""
        cells = (f"`{topic.name}`", f"`{topic.schema}`", topic.rate, topic.holds, frame)
        lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(lines) + "\n"
