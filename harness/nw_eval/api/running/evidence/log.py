"""One log read for what a page shows of it, within bounds, and without the simulator.

It runs in a confined process (`apart`): a log may be a stranger's, and pictures are unpacked.
"""

from __future__ import annotations

import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.api.running.evidence.above import Box, box_round, picture_from_above
from nw_eval.api.running.evidence.clip import clip_of
from nw_eval.api.running.evidence.content import Point, ReadLog, ReadLogs, ReadPlace
from nw_eval.api.running.evidence.pictures import LatestPictures
from nw_eval.clean import clean
from nw_eval.rollout.mcap.records import MOST_MESSAGE, LoggedMessage, logged

_PATH, _WAYPOINTS, _SCENE = "/robot/path", "/waypoints", "/scene"
_HIDDEN = frozenset({"place/overhead", "place/beside"})
"""Parts of a place that stand over the course or are left out of it."""
_FAR = 100.0
"""Metres round the course in which a walk is drawn."""


def read_logs(wanted: Sequence[tuple[str, str]], clips: Sequence[str], room: dict[str, int]) -> str:
    """Return what logs show, as JSON of `ReadLogs`; a log that is damaged costs what it shows.

    Args:
        wanted: path and scene of each log; the first of a scene that can be read shows its place.
        clips: paths of those whose last pictures are wanted too.
        room: bytes of one `picture` of a place and of one `clip`.
    """
    drawn: set[str] = set()
    found: list[ReadLog] = []
    for path, scene in wanted:
        try:
            read = _read(
                Path(path),
                place_bytes=0 if scene in drawn else room["picture"],
                clip_bytes=room["clip"] if path in clips else 0,
            )
        except Exception as error:  # noqa: BLE001 - Whatever a damaged file does to its readers.
            read = ReadLog(fault=_why(error))
        if read.place is not None:
            drawn.add(scene)
        found.append(read)
    return ReadLogs(logs=tuple(found)).model_dump_json()


def _read(path: Path, *, place_bytes: int, clip_bytes: int) -> ReadLog:
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError("it is not a file")
    first: dict[str, LoggedMessage] = {}
    walked: LoggedMessage | None = None
    pictures, end_ns = LatestPictures(), 0
    topics = () if clip_bytes else (_PATH, _WAYPOINTS, *([_SCENE] if place_bytes else []))
    with path.open("rb") as stream:
        for message in logged(stream, topics):
            end_ns = message.time_ns
            if message.topic == _PATH:
                walked = message
            elif message.topic in {_WAYPOINTS, _SCENE}:
                first.setdefault(message.topic, message)
            elif clip_bytes:
                pictures.take(message)
    if walked is None or _WAYPOINTS not in first:
        raise ValueError("it holds no walk, or no waypoints")
    points = _points(walked)
    waypoints, reach = _waypoints(first[_WAYPOINTS])
    box = box_round(np.array([points[0], *waypoints]))
    place = _place(first[_SCENE], box, place_bytes) if place_bytes and _SCENE in first else None
    return ReadLog(
        walked=_as_far_as_near(points, box),
        waypoints=waypoints,
        reach=reach,
        place=place,
        **_clip(pictures, end_ns, clip_bytes),
    )


def _points(message: LoggedMessage) -> NDArray[np.float64]:
    """Return the points of a cloud, (n, 2): x and y, m."""
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

    cloud = PointCloud.FromString(_bounded(message))
    stride = cloud.point_stride
    if stride < 8 or not cloud.data or len(cloud.data) % stride:
        raise ValueError("its walked path is damaged")
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, stride)
    return np.ascontiguousarray(rows[:, :8]).view("<f4").astype(np.float64)


def _as_far_as_near(points: NDArray[np.float64], box: Box) -> tuple[Point, ...]:
    """Return points until the first that is far away: where physics diverged, they are anywhere."""
    west, south, east, north = box
    near = (points > (west - _FAR, south - _FAR)) & (points < (east + _FAR, north + _FAR))
    is_far = ~near.all(axis=1)
    kept = points[: np.argmax(is_far)] if is_far.any() else points
    return tuple((round(x, 3), round(y, 3)) for x, y in kept.tolist())


def _waypoints(message: LoggedMessage) -> tuple[tuple[Point, ...], float | None]:
    """Return the discs of the waypoints: where they lie, and their radius."""
    discs = [entity.cylinders[0] for entity in _scene_update(message).entities if entity.cylinders]
    if not discs:
        raise ValueError("it has no waypoints")
    places = tuple(
        (round(disc.pose.position.x, 3), round(disc.pose.position.y, 3)) for disc in discs
    )
    return places, 0.5 * discs[0].size.x


def _place(message: LoggedMessage, box: Box, most_bytes: int) -> ReadPlace | None:
    ground = 0.0
    parts: list[NDArray[np.float64]] = []
    for entity in _scene_update(message).entities:
        if entity.id == "trail" and entity.lines and entity.lines[0].points:
            ground = entity.lines[0].points[0].z
        elif entity.id.startswith("place/") and entity.id not in _HIDDEN:
            parts += [_corners(triangles) for triangles in entity.triangles]
    triangles = np.concatenate(parts) if parts else np.empty((0, 3, 3))
    picture = picture_from_above(triangles, box, ground=ground, most_bytes=most_bytes)
    return ReadPlace(box=box, picture=picture) if picture else None


def _corners(triangles: Any) -> NDArray[np.float64]:
    """Return the corners of a list of triangles, (n, 3, 3) m."""
    points = np.array([(point.x, point.y, point.z) for point in triangles.points], np.float64)
    indices = np.array(triangles.indices, np.int64)
    return points[indices].reshape(-1, 3, 3)


def _clip(pictures: LatestPictures, end_ns: int, most_bytes: int) -> dict[str, Any]:
    """Return what a log has as `clip` and `unseen`."""
    try:
        topic, shown = pictures.shown(end_ns)
        if not shown:
            return {}
        clip = clip_of(shown, topic=clean(topic, at_most=200), most_bytes=most_bytes)
    except Exception as error:  # noqa: BLE001 - As above; the rest of the log may be whole.
        return {"unseen": _why(error)}
    return {"clip": clip} if clip else {"unseen": f"they need over {most_bytes} bytes"}


def _scene_update(message: LoggedMessage) -> Any:
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    return SceneUpdate.FromString(_bounded(message))


def _bounded(message: LoggedMessage) -> bytes:
    if len(message.data) > MOST_MESSAGE:
        raise ValueError(f"a message has over {MOST_MESSAGE // 2**20} MiB")
    return message.data


def _why(error: Exception) -> str:
    return clean(error, at_most=200) or type(error).__name__
