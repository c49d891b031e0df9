"""A log's pictures, each where its camera is: photographs as they lie in the log, and depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nw_eval.rollout.mcap.content.images import MILLIMETRES, image_of
from nw_eval.viewing.recording.blueprint import PLANE
from nw_eval.viewing.recording.place import WORLD, poses

if TYPE_CHECKING:
    from nw_eval.viewing.recording.place import Messages
    from nw_eval.viewing.recording.track import Track


def picture_topics(messages: Messages) -> list[str]:
    """Return the topics of pictures, in the order of the log."""
    return [t for t in messages if t.startswith("/camera/") and not t.endswith("/calib")]


def picture_entity(track: Track, topic: str) -> str:
    """Return the entity of a topic's pictures; no camera stands under another."""
    return track.entity(WORLD, "camera", topic.removeprefix("/camera/").replace("/", " "))


def write_pictures(track: Track, messages: Messages) -> None:
    """Write all pictures with their cameras.

    Raises:
        ValueError: one is damaged.
    """
    for topic in picture_topics(messages):
        entity, taken = picture_entity(track, topic), messages[topic]
        for _, calibration in messages.get(f"{topic}/calib", ()):
            pinhole = track.rr.Pinhole(
                image_from_camera=np.reshape(calibration.K, (3, 3)),
                resolution=(calibration.width, calibration.height),
                image_plane_distance=PLANE,
            )
            track.stays(entity, pinhole)
        frames = {message.frame_id for _, message in taken}
        for times, at, quats in poses(messages, frames).values():
            columns = track.rr.Transform3D.columns(translation=at, quaternion=quats)
            track.moves(entity, times, columns)
        for time, message in taken:
            track.at(time, entity, _archetype(track.rr, message))


def _archetype(rr: Any, message: Any) -> Any:
    if message.DESCRIPTOR.name == "CompressedImage":
        image_of(message)  # Damage is found here, not in the viewer.
        return rr.EncodedImage(contents=message.data, media_type=f"image/{message.format}")
    pixels = image_of(message)
    if message.encoding == "16UC1":
        whole = np.rint(pixels * MILLIMETRES).astype(np.uint16)
        return rr.DepthImage(whole, meter=MILLIMETRES)
    return rr.Image(pixels, color_model="L")
