"""Where everything is: place, robot, trail, waypoints, and the way that was walked."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from nw_eval.rollout.mcap.content.clouds import cloud_points
from nw_eval.viewing.recording.geometry import archetypes, cylinders

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_eval.viewing.recording.track import Track

    Messages = Mapping[str, Sequence[tuple[int, Any]]]
    """By topic: times in ns, and messages."""

WORLD = "world"
_PATH_COLOUR, _PATH_RADIUS = (25, 115, 240), 0.01


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
        track.at(time, track.entity(WORLD, "waypoints"), cylinders(discs, labels))
    for time, cloud in messages.get("/robot/path", ()):
        points, _ = cloud_points(cloud)
        path = track.rr.LineStrips3D([points], colors=[_PATH_COLOUR], radii=_PATH_RADIUS)
        track.at(time, track.entity(WORLD, "path"), path)
    bodies = {
        entity.frame_id
        for _, update in messages.get("/scene", ())
        for entity in update.entities
        if entity.id.startswith("robot/")
    }
    for body, (times, columns) in _moving(track, messages, bodies).items():
        track.moves(track.entity(WORLD, "robot", body), times, columns)


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
    found: defaultdict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
    for time, message in messages.get("/tf", ()):
        for transform in message.transforms:
            if transform.child_frame_id in frames:
                p, q = transform.translation, transform.rotation
                found[transform.child_frame_id].append((time, (p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
    split = {}
    for frame, rows in found.items():
        numbers = np.array([row for _, row in rows])
        split[frame] = ([time for time, _ in rows], numbers[:, :3], numbers[:, 3:])
    return split


def _moving(track: Track, messages: Messages, frames: set[str]) -> dict[str, tuple[list[int], Any]]:
    return {
        frame: (times, track.rr.Transform3D.columns(translation=at, quaternion=quats))
        for frame, (times, at, quats) in sorted(poses(messages, frames).items())
    }
