"""A trial's log as a recording of Rerun, a file that shows itself; and its layout alone.

What goes into it: the trial's place, its pictures, its numbers, its splat.
"""

from __future__ import annotations

from collections import defaultdict
from hashlib import file_digest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_base.files.cache import atomic_path, followed
from nw_eval.viewing.recording.track import (
    PLANE,
    TIME,
    SceneScreen,
    Track,
    WrittenRecording,
    blueprint,
    plot_of_entities,
    rerun_sdk,
    save_layout,
)
from nw_eval.viewing.shown import shown_in_log
from nw_sim.rollout.library import Library
from nw_sim.rollout.mcap.drawn import cloud_points
from nw_sim.rollout.mcap.images import MILLIMETRES, image_of
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_splat.files import read_splat
from nw_splat.gaussians import SH0, sigmoid, transformed, unit_quats

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_sim.rollout.replaying.logged import LoggedTrial
    from nw_splat.gaussians import Gaussians

    Messages = Mapping[str, Sequence[tuple[int, Any]]]
    """By topic: times in ns, and messages."""
    from collections.abc import Mapping, Sequence

WORLD = "world"
_PATH_COLOUR, _PATH_RADIUS = (25, 115, 240), 0.01

_LINE = 0.01  # m, radius

_JOINT = ("position", "velocity", "effort")
_TWIST = ("linear", "angular")
_COMMAND = ("forward", "left", "yaw_rate", "heading_error")
_POLICY = ("action", "applied", "targets")
_MOST = 256
"""Numbers of an observation that are lines; of more than that, one sees none."""


def write_place(track: Track, messages: Messages) -> None:
    """Write all that stands or moves in the world.

    Raises:
        ValueError: the messages are none of ours.
    """
    track.stays(WORLD, track.rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    for _, update in messages.get("/scene", ()):
        for entity in update.entities:
            # `place/ground`, `robot/trunk`, `trail`
            for kind, what in archetypes(entity).items():
                track.stays(track.entity(WORLD, *entity.id.split("/"), kind), what)
    for time, update in messages.get("/waypoints", ()):
        discs = [entity.cylinders[0] for entity in update.entities]
        labels = [str(number) for number in range(len(discs))]
        if discs:  # A task need have none.
            track.at(time, track.entity(WORLD, "waypoints"), cylinders(discs, labels))
    for time, cloud in messages.get("/robot/path", ()):
        points, _ = cloud_points(cloud)
        path = track.rr.LineStrips3D([points], colors=[_PATH_COLOUR], radii=_PATH_RADIUS)
        track.at(time, track.entity(WORLD, "path"), path)
    bodies = {
        entity.frame_id
        for _, update in messages.get("/scene", ())
        for entity in update.entities
        if entity.id.startswith(("robot/", "prop/"))
    }
    for body, (times, columns) in _moving(track, messages, bodies).items():
        parts = body.split("/") if body.startswith("prop/") else ("robot", body)
        track.moves(track.entity(WORLD, *parts), times, columns)


def first_pose(messages: Messages) -> tuple[float, float, float]:
    """Return where the trunk was first, m.

    Raises:
        LookupError: nowhere.
    """
    at = messages["/robot/odom"][0][1].pose.position
    return at.x, at.y, at.z


def poses(
    messages: Messages, frames: set[str]
) -> dict[str, tuple[list[int], np.ndarray, np.ndarray]]:
    """Return where frames are: times in ns, positions (T, 3) m, quaternions (T, 4) x y z w."""
    by_entity: defaultdict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
    for time, message in messages.get("/tf", ()):
        for transform in message.transforms:
            if transform.child_frame_id in frames:
                p, q = transform.translation, transform.rotation
                by_entity[transform.child_frame_id].append(
                    (time, (p.x, p.y, p.z, q.x, q.y, q.z, q.w))
                )
    split = {}
    for frame, rows in by_entity.items():
        numbers = np.array([row for _, row in rows])
        split[frame] = ([time for time, _ in rows], numbers[:, :3], numbers[:, 3:])
    return split


def _moving(track: Track, messages: Messages, frames: set[str]) -> dict[str, tuple[list[int], Any]]:
    return {
        frame: (times, track.rr.Transform3D.columns(translation=at, quaternion=quats))
        for frame, (times, at, quats) in sorted(poses(messages, frames).items())
    }


def archetypes(entity: Any) -> dict[str, Any]:
    """Return what a `foxglove.SceneEntity` of ours holds, by a name for each kind.

    Raises:
        ValueError: its triangles have corners that are not there.
    """
    rr = rerun_sdk()
    archetypes: dict[str, Any] = {}
    for number, triangles in enumerate(entity.triangles):
        archetypes[f"mesh{number or ''}"] = _mesh(triangles)
    for number, line in enumerate(entity.lines):
        points = [(p.x, p.y, p.z) for p in line.points]
        archetypes[f"line{number or ''}"] = rr.LineStrips3D(
            [points], colors=[_colour(line.color)], radii=_LINE
        )
    if entity.cubes:
        halves = [(0.5 * s.size.x, 0.5 * s.size.y, 0.5 * s.size.z) for s in entity.cubes]
        archetypes["boxes"] = rr.Boxes3D(half_sizes=halves, **_placed(entity.cubes))
    if entity.cylinders:
        archetypes["cylinders"] = cylinders(entity.cylinders)
    if entity.spheres:
        halves = [(0.5 * s.size.x, 0.5 * s.size.y, 0.5 * s.size.z) for s in entity.spheres]
        archetypes["ellipsoids"] = rr.Ellipsoids3D(half_sizes=halves, **_placed(entity.spheres))
    return archetypes


def cylinders(shapes: Any, labels: list[str] | None = None) -> Any:
    """Return `foxglove.CylinderPrimitive`s, which stand along z."""
    named = {} if labels is None else {"labels": labels}
    return rerun_sdk().Cylinders3D(
        lengths=[shape.size.z for shape in shapes],
        radii=[0.5 * shape.size.x for shape in shapes],
        **_placed(shapes),
        **named,
    )


def _placed(shapes: Any) -> dict[str, Any]:
    """Return where shapes stand, and their colours."""
    quats = [shape.pose.orientation for shape in shapes]
    return {
        "centers": [(p.x, p.y, p.z) for p in (shape.pose.position for shape in shapes)],
        "quaternions": [(q.x, q.y, q.z, q.w) for q in quats],
        "colors": [_colour(shape.color) for shape in shapes],
        "fill_mode": "solid",
    }


def _mesh(triangles: Any) -> Any:
    """Return triangles that share no corner, so that each has its own shade."""
    points = np.array([(p.x, p.y, p.z) for p in triangles.points], np.float32).reshape(-1, 3)
    indices = np.array(triangles.indices, np.int64)
    if indices.size % 3 or (indices.size and indices.max() >= len(points)):
        raise ValueError("a mesh has corners that are not there")
    corners = points[indices].reshape(-1, 3, 3)
    return rerun_sdk().Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(_normals(corners), 3, axis=0),
        triangle_indices=np.arange(indices.size, dtype=np.uint32).reshape(-1, 3),
        albedo_factor=_colour(triangles.color),
    )


def _normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return unit normals (N, 3) of triangles (N, 3, 3); of flat ones, zeros."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)


def _colour(color: Any) -> list[int]:
    channels = (color.r, color.g, color.b, color.a)
    return [min(255, max(0, round(255.0 * channel))) for channel in channels]


def picture_topics(messages: Messages) -> list[str]:
    """Return the topics of pictures, in the order of the log."""
    return [t for t in messages if t.startswith("/camera/") and not t.endswith("/calib")]


def _picture_entity(track: Track, topic: str) -> str:
    """Return the entity of a topic's pictures; no camera stands under another."""
    return track.entity(WORLD, "camera", topic.removeprefix("/camera/").replace("/", " "))


def picture_view(track: Track, messages: Messages, topic: str) -> tuple[str, str]:
    """Return the entity of a topic's pictures, and what their view is called."""
    entity = _picture_entity(track, topic)
    bent = any(_is_distorted(each) for _, each in messages.get(f"{topic}/calib", ()))
    return entity, f"{entity}, distorted" if bent else entity


def write_pictures(track: Track, messages: Messages) -> None:
    """Write all pictures with their cameras.

    Raises:
        ValueError: one is damaged.
    """
    for topic in picture_topics(messages):
        entity, taken = _picture_entity(track, topic), messages[topic]
        for _, calibration in messages.get(f"{topic}/calib", ()):
            pinhole = track.rr.Pinhole(
                image_from_camera=np.reshape(calibration.K, (3, 3)),
                resolution=(calibration.width, calibration.height),
                image_plane_distance=PLANE,
            )
            track.stays(entity, pinhole)
            if _is_distorted(calibration):
                track.stays(entity, _lens(track.rr, calibration))
        frames = {message.frame_id for _, message in taken}
        for times, at, quats in poses(messages, frames).values():
            columns = track.rr.Transform3D.columns(translation=at, quaternion=quats)
            track.moves(entity, times, columns)
        for time, message in taken:
            track.at(time, entity, _archetype(track.rr, message))


def _is_distorted(calibration: Any) -> bool:
    """Say whether a `foxglove.CameraCalibration` is of a lens that bends straight lines."""
    return any(calibration.D)


def _lens(rr: Any, calibration: Any) -> Any:
    """Return the distortion that a pinhole lacks: Rerun 0.41 has no archetype for it.

    See https://github.com/rerun-io/rerun/issues/2499.
    """
    note = (
        "Rerun knows no distortion: frustum, depth in 3D and what is drawn over this picture are "
        "those of a pinhole. The picture is as the lens sees it."
    )
    said = {"model": calibration.distortion_model, "coefficients": list(calibration.D)}
    return rr.DynamicArchetype("Distortion", components={**said, "note": note})


def _archetype(rr: Any, message: Any) -> Any:
    if message.DESCRIPTOR.name == "CompressedImage":
        image_of(message)  # Damage is found here, not in the viewer.
        return rr.EncodedImage(contents=message.data, media_type=f"image/{message.format}")
    pixels = image_of(message)
    if message.encoding == "16UC1":
        whole = np.rint(pixels * MILLIMETRES).astype(np.uint16)
        return rr.DepthImage(whole, meter=MILLIMETRES)
    return rr.Image(pixels, color_model="L")


def write_series(track: Track, messages: Messages, elements: Mapping[str, Sequence[str]]) -> None:
    """Write all numbers.

    Raises:
        ValueError: a message has another number of them than the one before.
    """
    _write_robot(track, messages)
    for field in _POLICY:
        steps = messages.get("/nw/policy", ())
        rows = [list(getattr(message, field)) for _, message in steps]
        names = elements.get(f"/nw/policy.{field}", ())
        _write(track, f"/policy/{field}", [time for time, _ in steps], rows, names)
    for topic, samples in messages.items():
        if topic.startswith("/observation/"):
            _write_observation(track, topic, samples, elements.get(topic, ()))


def _write_robot(track: Track, messages: Messages) -> None:
    joints = messages.get("/robot/joints", ())
    times = [time for time, _ in joints]
    for field in _JOINT:
        rows = [[getattr(joint, field) for joint in message.joints] for _, message in joints]
        names = [joint.name for joint in joints[0][1].joints] if joints else ()
        _write(track, f"/joints/{field}", times, rows, names)
    twists = messages.get("/robot/twist", ())
    for part in _TWIST:
        rows = [[getattr(getattr(m, part), axis) for axis in "xyz"] for _, m in twists]
        names = [f"{part} {axis}" for axis in "xyz"]
        _write(track, f"/twist/{part}", [time for time, _ in twists], rows, names)
    commands = messages.get("/robot/command", ())
    rows = [[getattr(message, field) for field in _COMMAND] for _, message in commands]
    _write(track, "/command", [time for time, _ in commands], rows, _COMMAND)


def _write_observation(
    track: Track, topic: str, samples: Sequence[tuple[int, Any]], names: Sequence[str]
) -> None:
    """Write an observation: an entity for each of its terms, or one for all of it."""
    times = [time for time, _ in samples]
    terms = samples[0][1].terms
    first = 0
    for number, entity in enumerate(term_entities(track, topic, [term.name for term in terms])):
        rows = [list(message.terms[number].values) for _, message in samples]
        size = len(rows[0])
        if size <= _MOST:
            _write(track, entity, times, rows, names[first : first + size])
        first += size


def term_entities(track: Track, topic: str, terms: Sequence[str]) -> list[str]:
    """Return the entities of an observation's terms, which may be untrusted words."""
    parts = topic.strip("/").split("/")
    if len(terms) == 1:
        return [track.entity(*parts)]
    return [track.entity(*parts, f"{number:02d} {name}") for number, name in enumerate(terms)]


def _write(
    track: Track,
    entity: str,
    times: Sequence[int],
    rows: Sequence[Sequence[float]],
    names: Sequence[str],
) -> None:
    if not rows or not rows[0]:
        return
    numbers = np.array(rows, np.float64)  # a ValueError where rows differ in length
    known = names if len(names) == numbers.shape[1] else [str(k) for k in range(len(rows[0]))]
    track.numbers(entity, times, numbers, known)


def place_splat(logged: LoggedTrial) -> tuple[Gaussians | None, str]:
    """Return the Gaussians of a logged trial's place in its world, or None and why there are none.

    The scene is found as for a replay. A log shows the rest of its trial without it.
    """
    job = logged.job
    try:
        scene = Library().scene(job.scene, job.collision)
        if scene.digest != job.trial.scene_digest:
            return None, f"scene {scene.name} has changed since"
        if scene.splat is None:
            return None, f"scene {scene.name} has no splat"
        return transformed(read_splat(scene.splat_store()), scene.T_world_splat), ""
    except NwEvalError as error:
        return None, str(error)


def splat_archetype(gaussians: Gaussians) -> Any:
    """Return Gaussians with the colour that they have from all sides: without harmonics."""
    colours = 0.5 + SH0 * gaussians.sh[:, 0].astype(np.float64)
    rgba = np.concatenate([colours, sigmoid(gaussians.opacity_logits)[:, np.newaxis]], axis=1)
    return rerun_sdk().GaussianSplats3D(
        centers=gaussians.means,
        scales=np.exp(gaussians.log_scales),
        quaternions=unit_quats(gaussians.quats)[:, [1, 2, 3, 0]].astype(np.float32),
        colors=np.rint(np.clip(rgba, 0.0, 1.0) * 255.0).astype(np.uint8),
    )


SUFFIX = ".rrd"
_MOST_PICTURES, _MOST_TERMS = 3, 2
_UNSHOWN = ("/nw/state", "/points/")  # states are for replays, points for viewers without meshes

_LAYOUT_SUFFIX = ".rbl"


def write_recording(log: Path, out: Path) -> WrittenRecording:
    """Write a log as Rerun's own: meshes, robot, Gaussians, pictures, and numbers by name.

    Raises:
        PrerequisiteError: Rerun is not installed.
        UsageError: `out` has another suffix than `.rrd`.
        StoreError: the log cannot be read or is damaged, or the recording not written.
    """
    rerun_sdk()
    if out.suffix.lower() != SUFFIX:
        raise UsageError(f"{out}: Rerun knows its recordings by {SUFFIX}", fix="name it so")
    logged = read_logged_trial(log)
    messages = _messages(logged)
    gaussians, no_splat = place_splat(logged)
    with atomic_path(followed(out)) as temporary:
        try:
            _write_whole(temporary, logged, messages, gaussians)
        except (ValueError, LookupError) as error:
            reason = clean(error, at_most=200)
            raise StoreError(f"{log} is damaged: {reason}", fix="run the trial again") from error
        size = temporary.stat().st_size
    return WrittenRecording(
        file=out,
        bytes=size,
        gaussians=0 if gaussians is None else len(gaussians),
        no_splat=no_splat,
    )


def _messages(logged: LoggedTrial) -> dict[str, list[tuple[int, Any]]]:
    by_topic: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, time, message in logged.log.messages():
        if not topic.startswith(_UNSHOWN):
            by_topic[topic].append((time, message))
    return dict(by_topic)


def _write_whole(
    path: Path, logged: LoggedTrial, messages: dict[str, list[tuple[int, Any]]], gaussians: Any
) -> None:
    elements = logged.log.elements()
    trial = clean(logged.job.trial.id, at_most=200)
    with logged.path.open("rb") as stream:
        digest = file_digest(stream, "sha256").hexdigest()
    with Track(f"{trial}-{digest[:12]}", path, name=trial) as track:
        track.lay_out(_layout(track, messages, elements, has_splat=gaussians is not None))
        write_place(track, messages)
        if gaussians is not None:
            track.stays(track.entity(WORLD, "splat"), splat_archetype(gaussians))
        write_pictures(track, messages)
        write_series(track, messages, elements)
        for time, line in messages.get("/log", ()):
            track.at(time, "log", track.rr.TextLog(line.message, level=_level(line)))


def _layout(
    track: Track,
    messages: Messages,
    elements: Mapping[str, Sequence[str]],
    *,
    has_splat: bool,
) -> Any:
    """Return what the recording shows when it is opened."""
    start, trunk = first_pose(messages), messages["/robot/twist"][0][1].frame_id
    topics = picture_topics(messages)[:_MOST_PICTURES]
    plots = [
        plot_of_entities("Velocity, commanded and measured", ["/command", "/twist/linear"]),
        plot_of_entities("Joint angles", ["/joints/position"]),
        plot_of_entities("Joint targets", ["/policy/targets"]),
    ]
    if seen := next((t for t in messages if t.startswith("/observation/") and t in elements), None):
        names = [term.name for term in messages[seen][0][1].terms]
        entities = term_entities(track, seen, names)[:_MOST_TERMS]
        plots.append(plot_of_entities("What the policy was given", entities))
    return blueprint(
        place=SceneScreen(
            root=f"/{WORLD}",
            follows=track.entity(WORLD, "robot", trunk),
            start=start,
            # Splat and mesh lie on each other: half of either shows through.
            hides=(f"/{WORLD}/place",) if has_splat else (),
        ),
        pictures=dict(picture_view(track, messages, topic) for topic in topics),
        plots=plots,
        timeline=TIME,
    )


def _level(line: Any) -> str:
    return "ERROR" if line.level == line.ERROR else "INFO"


def write_layout(log: Path, out: Path) -> Path:
    """Write how Rerun is to show a log that it has converted itself; return `out`.

    Raises:
        PrerequisiteError: Rerun is not installed.
        UsageError: `out` has another suffix than `.rbl`.
        StoreError: the log cannot be read or is damaged, or the layout not written.
    """
    rerun_sdk()
    if out.suffix.lower() != _LAYOUT_SUFFIX:
        raise UsageError(f"{out}: Rerun knows its layouts by {_LAYOUT_SUFFIX}", fix="name it so")
    shown = shown_in_log(LogReader(log))
    with atomic_path(followed(out)) as temporary:
        save_layout(shown, temporary)
    return out
