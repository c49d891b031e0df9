"""What a robot is, which line says what of it, and whether it stands."""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from nw_base.confinement import Rules, memory_to_run
from nw_base.errors import CrashError, PolicyError, RobotError
from nw_base.lens import Intrinsics
from nw_scenes.robots import FoundRobot, RobotSpec, files_of, find_robot, robot_folder
from nw_scenes.robots.kept import keep, packed
from nw_scenes.robots.spec import CameraMount
from nw_scenes.robots.standing import Drop, LevelGround
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.confined.access import robots_kept
from nw_sim.rollout.confined.isolated import call_isolated
from nw_sim.rollout.replaying.third_person import Spectator
from nw_sim.sensors.drawing.pictures import Cell, draw_sheet
from nw_sim.sensors.shutter import shutter_words
from nw_splat.camera import look_at

FLAT = "flat/carpet_room"
"""Where a robot is drawn."""
STANDING_SECONDS = 120
"""Of processor time; a robot of 20,000 triangles takes 2."""
_WAITED = 3600.0
"""Seconds for which an answer is waited for: on a busy machine, processor time is long."""
_VIEW = (400, 270)
_FOVY = math.radians(42.0)
_NEAR_LIMIT = 0.9  # of a motor's largest torque
_SAGGED = 0.3  # rad between a joint and its target
_UNLIMITED = 1e5  # rad


@dataclass(frozen=True, kw_only=True)
class RobotJoint:
    """A joint that is driven, and which line says its motor."""

    joint: str
    pose: float
    """What action 0 means, rad."""
    low: float | None
    """The end of its range, rad; None = it has none."""
    high: float | None
    kp: float
    """N m / rad."""
    kd: float
    """N m s / rad."""
    torque: float
    """The largest, N m."""
    armature: float
    """kg m^2."""
    friction: float
    """N m."""
    source: str
    """Where its gains and limits are from."""


@dataclass(frozen=True, kw_only=True)
class RobotEye:
    """A camera of a robot."""

    name: str
    position: tuple[float, float, float]
    """On the root, m."""
    pitch: float
    """By which it looks down, rad."""
    fovy: float
    """Vertical field of view, rad."""
    intrinsics: dict[str, Any] | None = None
    """As robot.yaml has them; None where it has none."""
    readout: float = 0.0
    """From the first row to the last, s."""
    exposure: float = 0.0
    """Of each row, s."""


@dataclass(frozen=True, kw_only=True)
class RobotSummary:
    """All that is known of a robot. SI units, radians."""

    name: str
    reference: str
    """What rows and `run.json` call it."""
    place: str
    """The folder or package that it is of; `nw-eval` for a built-in one."""
    mass: float
    """kg."""
    root: str
    """The body with the free joint."""
    bodies: int
    feet: tuple[str, ...]
    body: tuple[str, ...]
    """The parts whose contact is `collided`."""
    collided_force: float
    """On one of them, N."""
    fell_tilt: float
    """rad."""
    fell_height: float | None
    """m; None = no limit."""
    spawn_height: float
    """Of the root above the ground at the start, m."""
    eyes: tuple[RobotEye, ...]
    joints: tuple[RobotJoint, ...]
    sources: dict[str, str]
    """Which line each of `root`, `feet`, `pose`, `body`, `fell`, `collided`, `eye` and
    `spawn_height` is from, or what it is derived from."""


@dataclass(frozen=True, kw_only=True)
class CheckedFoot:
    """A foot, 2 s after the robot was put down."""

    foot: str
    force: float
    """From the ground, upwards, N."""


@dataclass(frozen=True, kw_only=True)
class CheckedRobot:
    """A robot that was put down in its pose, with its gains, and stood or not."""

    name: str
    place: str
    mass: float
    """kg."""
    spawn_height: float
    """Of the root above the ground where it was put down, m."""
    height: float
    """The same after 2 s, m."""
    tilt: float
    """Of the root after 2 s, rad."""
    held: bool
    """Whether its root was kept upright and in its place, as by a gantry: it has fewer than three
    feet, which a policy must balance."""
    fell_after: float | None
    """Seconds until it fell when nothing held it; None = it did not fall in 2 s."""
    stands: bool
    feet: tuple[CheckedFoot, ...]
    others: tuple[CheckedFoot, ...]
    """Bodies that are no feet, and touched the ground."""
    carriers: tuple[str, ...]
    """Those of `others` that carry more than 2 % of its weight."""
    torque_shares: dict[str, float]
    """By joint: its torque in standing, in shares of its largest."""
    self_contacts: tuple[tuple[str, str], ...]
    """Bodies that pushed each other."""
    eye: RobotEye
    notes: tuple[str, ...]
    """What is odd, or worth knowing."""


def summary_of(entry: FoundRobot) -> RobotSummary:
    """Return all that is known of a robot.

    Raises:
        RobotError: its folder cannot be read any more.
    """
    robot = entry.spec
    ground = LevelGround(robot)
    sources, of_joints = _sources(entry)
    eyes = tuple(_eye(name, mount) for name, mount in robot.cameras.items())
    return RobotSummary(
        name=robot.name,
        reference=entry.reference,
        place=place_of(entry),
        mass=ground.mass,
        root=robot.root,
        bodies=len(robot.bodies),
        feet=robot.feet,
        body=robot.monitored,
        collided_force=robot.collided_force,
        fell_tilt=robot.fell_tilt,
        fell_height=robot.fell_height,
        spawn_height=robot.spawn_height,
        eyes=eyes,
        joints=tuple(
            RobotJoint(
                joint=name,
                pose=robot.default_pose[i],
                low=None if robot.joint_ranges[i][0] < -_UNLIMITED else robot.joint_ranges[i][0],
                high=None if robot.joint_ranges[i][1] > _UNLIMITED else robot.joint_ranges[i][1],
                kp=robot.kp[i],
                kd=robot.joint_damping[i],
                torque=robot.torque_limits[i],
                armature=robot.armature[i],
                friction=robot.friction_loss[i],
                source=of_joints[i],
            )
            for i, name in enumerate(robot.joints)
        ),
        sources=sources,
    )


def place_of(entry: FoundRobot) -> str:
    """Return where a robot is from."""
    if entry.folder is not None:
        return str(entry.folder)
    return f"package {entry.identity}" if entry.identity else "nw-eval"


def _eye(name: str, mount: CameraMount) -> RobotEye:
    down = -mount.R_trunk_camera[2][2]  # Of its optical axis.
    pitch = math.asin(min(max(down, -1.0), 1.0))
    lens = mount.intrinsics
    return RobotEye(
        name=name,
        position=mount.position,
        pitch=pitch,
        fovy=mount.fovy,
        intrinsics=None if lens is None else lens.model_dump(mode="json", exclude_none=True),
        readout=mount.readout,
        exposure=mount.exposure,
    )


_DERIVED = {
    "root": "the body with the free joint",
    "feet": "the bodies that are lowest in the pose, or carry it in a drop of 2 s",
    "pose": "zeros, or the nearest in the range",
    "body": "the root",
    "fell": "the default",
    "collided": "the default",
    "eye": "no fixed camera in the file: at the front, looking ahead",
    "spawn_height": "the lowest point that collides in the pose, and 1 cm",
}


def _sources(entry: FoundRobot) -> tuple[dict[str, str], list[str]]:
    """Return where each setting is from, and where each joint's motor is."""
    robot = entry.spec
    if entry.folder is None:
        return dict.fromkeys(_DERIVED, place_of(entry)), [place_of(entry)] * len(robot.joints)
    from nw_scenes.robots.derived import facts_of
    from nw_scenes.robots.folder import read_folder
    from nw_scenes.robots.robot_file import ROBOT_FILE

    folder = read_folder(entry.folder)
    settings, model = folder.settings, folder.settings.model.file

    def line(*key: str | int) -> str:
        return f"{ROBOT_FILE}:{folder.file.place(key)[0]}"

    sources = {
        key: line(key) if key in settings.model_fields_set else f"derived: {how}"
        for key, how in _DERIVED.items()
    }
    if settings.pose is None and "home" in folder.poses:
        sources["pose"] = f"derived: the keyframe `home` of {model}"
    camera = facts_of(folder).camera if settings.eye is None else None
    if camera is not None:
        where = f"{model}:{folder.line_of(camera, 'camera')}"
        sources["eye"] = f"derived: the camera {camera!r}, {where}"
    actuators = {each.get("joint"): each for kind in folder.model.iter("actuator") for each in kind}
    joints: list[str] = []
    for name in robot.joints:
        parts = [f"{model}:{folder.line_of(name, 'joint')}"]
        if (actuator := actuators.get(name)) is not None:
            parts.append(f"{model}:{folder.lines[actuator]}")
        for number, group in enumerate(settings.motors):
            patterns = [group.joints] if isinstance(group.joints, str) else group.joints
            if any(fnmatchcase(name, pattern) for pattern in patterns):
                parts.append(line("motors", number))
        joints.append(", ".join(parts))
    return sources, joints


def check_robot(reference: str) -> tuple[CheckedRobot, bytes]:
    """Stand a robot for 2 s, in a confined process.

    Args:
        reference: as for `find_robot`.

    Returns:
        What became of it, and a PNG of it from outside and from its eye.

    Raises:
        UsageError: there is no such robot.
        RobotError: its folder cannot be used.
    """
    folder = robot_folder(reference)
    if folder is not None:
        reference = f"{folder}/"
    answer = isolated(_check, subject=reference, folder=folder, robot=reference)
    try:
        checked = TypeAdapter(CheckedRobot).validate_python(answer["checked"])
        picture = TypeAdapter(bytes, config={"val_json_bytes": "base64"}).validate_json(
            f'"{answer["picture"]}"'
        )
        if folder is not None:
            files = TypeAdapter(list[str]).validate_python(answer["files"])
            keep(folder, files, b64decode(TypeAdapter(str).validate_python(answer["kept"])))
    except (ValueError, KeyError, TypeError):
        raise RobotError(f"{reference}: the check gave no answer that can be read") from None
    return checked, picture


def isolated(function: Any, *, subject: str, folder: Path | None, **arguments: Any) -> Any:
    """Call a function in a confined process that reads a robot's folder.

    Raises:
        RobotError: what the function raised; or the process died, or took too long.
    """
    reads = () if folder is None else (folder.resolve(), *robots_kept())
    rules = Rules(
        reads=reads, memory=memory_to_run(_size(folder), scenes=1), seconds=STANDING_SECONDS
    )
    try:
        return call_isolated(
            function, subject=subject, rules=rules, time_limit=_WAITED, **arguments
        )
    except CrashError:
        raise RobotError(
            f"{subject}: the process that simulated it died",
            fix="compile the model with MuJoCo on its own, and thin its meshes out",
        ) from None
    except PolicyError as error:
        words = error.message.replace("opening the checkpoint", "reading the robot")
        fix = "thin its meshes out, above all those that collide" if "takes" in words else None
        raise RobotError(words.replace("the checkpoint", "the robot"), fix=fix) from None


def _size(folder: Path | None) -> int:
    """Return how many bytes the meshes of a folder may take."""
    from nw_scenes.robots.folder import MESHES_BYTES

    if folder is None:
        return 0
    try:
        sizes = [
            p.stat().st_size for p in folder.rglob("*") if p.suffix.lower() in {".stl", ".obj"}
        ]
    except OSError:
        return MESHES_BYTES
    return min(sum(sizes), MESHES_BYTES)


def _check(*, robot: str) -> dict[str, Any]:
    """Stand a robot, and draw it; as plain values."""
    checked, dropped, entry = check_here(robot)
    files = files_of(entry)
    return {
        "files": list(files),
        "kept": b64encode(packed(entry.spec, entry.notes)).decode() if files else "",
        "checked": asdict(checked),
        "picture": b64encode(_picture(entry.spec, dropped, checked)).decode(),
    }


def check_here(reference: str) -> tuple[CheckedRobot, Drop, FoundRobot]:
    """As `check_robot` without the picture, in this process: for robots that one trusts.

    Raises:
        UsageError, RobotError: as `check_robot`.
    """
    entry = find_robot(reference)
    robot, ground = entry.spec, LevelGround(entry.spec)
    free = ground.drop()
    held = len(robot.feet) < 3
    dropped = ground.drop(held=True) if held else free
    feet = ground.bodies_of(robot.feet)
    shares = [
        torque / limit if limit > 0.0 else 0.0
        for torque, limit in zip(dropped.torques, robot.torque_limits, strict=True)
    ]
    others = {body: force for body, force in dropped.forces.items() if body not in feet}
    carriers = tuple(body for body in others if body in dropped.carriers)
    checked = CheckedRobot(
        name=robot.name,
        place=place_of(entry),
        mass=ground.mass,
        spawn_height=dropped.spawn_height,
        height=dropped.height,
        tilt=math.acos(min(max(dropped.upright, -1.0), 1.0)),
        held=held,
        fell_after=free.fell_after,
        stands=dropped.stands and dropped.fell_after is None,
        feet=tuple(
            CheckedFoot(foot=foot, force=dropped.forces.get(body, 0.0))
            for foot, body in zip(robot.feet, feet, strict=True)
        ),
        others=tuple(CheckedFoot(foot=body, force=force) for body, force in others.items()),
        carriers=carriers,
        torque_shares=dict(zip(robot.joints, shares, strict=True)),
        self_contacts=dropped.self_contacts,
        eye=_eye("ego", robot.cameras["ego"]),
        notes=tuple(_notes(entry, dropped, free, shares, carriers, feet)),
    )
    return checked, dropped, entry


def _notes(
    entry: FoundRobot,
    dropped: Drop,
    free: Drop,
    shares: Sequence[float],
    carriers: Sequence[str],
    feet: Sequence[str],
) -> list[str]:
    robot, notes = entry.spec, list[str]()
    if dropped is not free and not free.stands:
        when = "" if free.fell_after is None else f" after {free.fell_after:.2f} s"
        notes.append(f"released, it falls{when}: its gains do not balance it, so its policy must")
    idle = [foot for foot, body in zip(robot.feet, feet, strict=True) if body not in dropped.forces]
    if idle:
        notes.append(f"feet that do not touch the ground: {', '.join(idle)}; see `pose` and `feet`")
    if carriers:
        notes.append(
            f"bodies that bear weight but are not listed as feet: {', '.join(carriers)}; see "
            "`pose`, `feet`, and the gains"
        )
    sagged = [
        f"{name} by {abs(at - target):.2f} rad"
        for name, at, target in zip(
            robot.joints, dropped.positions, robot.default_pose, strict=True
        )
        if abs(at - target) > _SAGGED
    ]
    if sagged:
        notes.append(f"gains do not hold the pose: {_few(sagged)}; see `kp` of `motors`")
    strained = [
        f"{name} at {share:.0%}"
        for name, share in zip(robot.joints, shares, strict=True)
        if share > _NEAR_LIMIT
    ]
    if strained:
        notes.append(f"motors at their limits as it stands: {_few(strained)}; see `torque`")
    if dropped.self_contacts:
        pairs = [f"{one} and {other}" for one, other in dropped.self_contacts]
        notes.append(f"it touches itself: {_few(pairs)}")
    return [*notes, *_joint_notes(entry), *entry.notes]


def _joint_notes(entry: FoundRobot) -> list[str]:
    robot, notes = entry.spec, list[str]()
    ranges = zip(robot.joints, robot.joint_ranges, robot.default_pose, strict=True)
    unlimited: list[str] = []
    beyond: list[str] = []
    for name, (low, high), pose in ranges:
        if max(-low, high) > _UNLIMITED:
            unlimited.append(name)
        elif not low - 1e-6 <= pose <= high + 1e-6:
            beyond.append(f"{name} {pose:.2f} of {low:.2f}..{high:.2f}")
    if beyond:
        notes.append(f"the pose is beyond the range of {_few(beyond)}")
    if unlimited and entry.folder is not None:
        from nw_scenes.robots.folder import read_folder

        folder = read_folder(entry.folder)
        file = folder.settings.model.file
        unlimited = [f"{name} ({file}:{folder.line_of(name, 'joint')})" for name in unlimited]
    if unlimited:
        notes.append(f"joints without a range: {_few(unlimited)}")
    return notes


def _few(words: Sequence[str], most: int = 6) -> str:
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def _picture(robot: RobotSpec, dropped: Drop, checked: CheckedRobot) -> bytes:
    """Return a PNG of a robot from outside and from its eye, in a room."""
    scene = get_scene(FLAT)
    spectator = Spectator(scene, None)
    width, height = _VIEW
    with World(robot, scene) as world:
        if checked.held:
            x, y, z = scene.spawn.position
            place = (x, y, z + dropped.height)
            world.reset(position=place, yaw=scene.spawn.yaw, joint_positions=dropped.positions)
        else:
            for _ in range(100):
                world.step(robot.default_pose)
        yaw = float(world.roll_pitch_yaw[2])
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        middle, away = world.center_of_mass, 1.0 + 1.9 * robot.spawn_height
        eye = middle + away * np.array([*(turn @ (0.72, -0.62)), 0.3])
        outside = spectator.view(
            look_at(eye, middle), _FOVY, world, scene.trail, width=width, height=height
        )
        aboard = spectator.aboard(world, scene.trail, "ego", width=width, height=height)
    ending = "stands" if checked.stands else "does not stand"
    if checked.stands and checked.carriers:
        ending += f" on {_few(checked.carriers)} too"
    gantry = ", held upright" if checked.held else ""
    title = f"{robot.name}: {checked.mass:.1f} kg, {ending}{gantry}, root at {checked.height:.2f} m"
    cells = [
        Cell(name="from outside", caption="after 2 s", images=[outside]),
        Cell(name="from its eye", caption=eye_words(checked.eye), images=[aboard]),
    ]
    return draw_sheet(cells, across=2, title=title)


def eye_words(eye: RobotEye) -> str:
    """Return where a camera sits and looks."""
    x, y, z = eye.position
    down = f"{math.degrees(eye.pitch):.0f} degrees down" if abs(eye.pitch) > 5e-3 else "ahead"
    location = (
        f"at {x:.2f} {y:.2f} {z:.2f} m of the root, {down}, {math.degrees(eye.fovy):.0f} degrees"
    )
    taken = shutter_words(eye.readout, eye.exposure)
    taken = taken and f", {taken}"
    if eye.intrinsics is None:
        return location + taken
    lens = Intrinsics.model_validate(eye.intrinsics)
    bent = "" if lens.distortion is None else f", {lens.distortion.model}"
    return (
        f"{location}, {lens.width} x {lens.height} with fx {lens.fx:g} fy {lens.fy:g} "
        f"cx {lens.cx:g} cy {lens.cy:g}{bent}{taken}"
    )
