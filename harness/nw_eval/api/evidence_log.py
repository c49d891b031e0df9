"""One log read for what a page shows of it, within bounds, and without the simulator.

It runs in a confined process (`evidence`): a log may be untrusted, and pictures are unpacked. A
log shows the walk, when contacts began, and the scene from straight above as the mesh that the log
holds, drawn small. It shows the last seconds of a camera's pictures as one that moves: an animated
WebP, small enough.
"""

from __future__ import annotations

import stat
from collections import deque
from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from nw_base.clean import clean
from nw_sim.rollout.mcap.reader import MOST_MESSAGE, LoggedMessage, logged

if TYPE_CHECKING:
    from PIL.Image import Image

_Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
_Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Point = tuple[_Metres, _Metres]
"""x and y in the world frame, m."""

_MOST_POINTS = 20_000
"""Of a path: half an hour at 10 Hz."""
_LONGEST = 300
"""Characters of a text."""
PATH_SECONDS = 0.1
"""Between two points of a path, where its log is too short to say."""
_MOST_CONTACTS = 200
"""Of a trial, the first ones; a policy that scrapes along a wall begins a contact at every step."""


class _Read(BaseModel):
    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        ser_json_bytes="base64",
        val_json_bytes="base64",
    )


class ReadScene(_Read):
    """The scene of a trial from straight above."""

    box: tuple[_Metres, _Metres, _Metres, _Metres]
    """West, south, east, north."""
    picture: bytes
    """A WebP of what lies in the box."""


class ReadClip(_Read):
    """The last seconds of what a camera saw."""

    data: bytes
    """An animated WebP."""
    still: bytes
    """Its last picture, a WebP."""
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    topic: str = Field(max_length=_LONGEST)
    seconds: float = Field(ge=0.0)


class ReadLog(_Read):
    """All of it."""

    fault: str = Field(default="", max_length=_LONGEST)
    """Why it cannot be read; empty if it can, and then there is a path."""
    walked: tuple[Point, ...] = Field(default=(), max_length=_MOST_POINTS)
    period: float = Field(default=PATH_SECONDS, gt=0.0, le=10.0)
    """Seconds between two points of the walk; the last one may come sooner."""
    contacts: tuple[_Seconds, ...] = Field(default=(), max_length=_MOST_CONTACTS)
    """When each contact of head or trunk began, s."""
    waypoints: tuple[Point, ...] = Field(default=(), max_length=1000)
    reach: float | None = None
    """Metres from a waypoint at which it counts as reached."""
    place: ReadScene | None = None
    clip: ReadClip | None = None
    unseen: str = Field(default="", max_length=_LONGEST)
    """Why its pictures cannot be shown; empty if they are, are not wanted, or there are none."""

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if not self.fault and not self.walked:
            raise ValueError("neither a fault nor a path")
        return self


class ReadLogs(_Read):
    """Several, in the order in which they were wanted."""

    logs: tuple[ReadLog, ...]


_PATH, _WAYPOINTS, _SCENE, _EVENT = "/robot/path", "/waypoints", "/scene", "/nw/event"
_HIDDEN = frozenset({"place/overhead", "place/beside"})
"""Parts of a scene that stand over the course or are left out of it."""
_FAR = 100.0
"""Metres round the course in which a walk is drawn."""
_LEAST_ROUND, _MOST_ROUND = 5.0, 20.0
"""Metres to each side of the start that are drawn of a scene where there are no waypoints."""


def read_logs(wanted: Sequence[tuple[str, str]], clips: Sequence[str], room: dict[str, int]) -> str:
    """Return what logs show, as JSON of `ReadLogs`; a log that is damaged costs what it shows.

    Args:
        wanted: path and scene of each log; the first of a scene that can be read shows its place.
        clips: paths of those whose last pictures are wanted too.
        room: bytes of one `picture` of a scene and of one `clip`.
    """
    drawn: set[str] = set()
    logs: list[ReadLog] = []
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
        logs.append(read)
    return ReadLogs(logs=tuple(logs)).model_dump_json()


def _read(path: Path, *, place_bytes: int, clip_bytes: int) -> ReadLog:
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError("it is not a file")
    first: dict[str, LoggedMessage] = {}
    walked: list[LoggedMessage] = []
    contacts: list[float] = []
    pictures, end_ns = LatestPictures(), 0
    topics = () if clip_bytes else (_PATH, _WAYPOINTS, _EVENT, *([_SCENE] if place_bytes else []))
    with path.open("rb") as stream:
        for message in logged(stream, topics):
            end_ns = message.time_ns
            if message.topic == _PATH:
                walked = [*walked[-1:], message]
            elif message.topic == _EVENT:
                if len(contacts) < _MOST_CONTACTS and _is_contact(message):
                    contacts.append(round(message.time_ns * _SECOND, 3))
            elif message.topic in {_WAYPOINTS, _SCENE}:
                first.setdefault(message.topic, message)
            elif clip_bytes:
                pictures.take(message)
    if not walked or _WAYPOINTS not in first:
        raise ValueError("it holds no walk, or no waypoints")
    points = _points(walked[-1])
    waypoints, reach = _waypoints(first[_WAYPOINTS])
    corners = np.array([points[0], *waypoints]) if waypoints else _square_round(points)
    box = box_round(corners)
    place = _place(first[_SCENE], box, place_bytes) if place_bytes and _SCENE in first else None
    return ReadLog(
        walked=_as_far_as_near(points, box),
        period=_period(walked[0]) if len(walked) > 1 else PATH_SECONDS,
        contacts=tuple(contacts),
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


def _period(message: LoggedMessage) -> float:
    """Return the seconds between points of a path, of which all but the last are equally apart."""
    steps = len(_points(message)) - 1
    return round(message.time_ns * _SECOND / steps, 6) if steps > 0 else PATH_SECONDS


def _is_contact(message: LoggedMessage) -> bool:
    from nw_sim.rollout.mcap.messages import Event

    return Event.FromString(_bounded(message)).kind == "contact"


def _as_far_as_near(points: NDArray[np.float64], box: Box) -> tuple[Point, ...]:
    """Return points until the first that is far away: where physics diverged, they are anywhere."""
    west, south, east, north = box
    near = (points > (west - _FAR, south - _FAR)) & (points < (east + _FAR, north + _FAR))
    is_far = ~near.all(axis=1)
    kept = points[: np.argmax(is_far)] if is_far.any() else points
    return tuple((round(x, 3), round(y, 3)) for x, y in kept.tolist())


def _square_round(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two corners round the start of a walk that has no way: other trials go elsewhere."""
    away = np.abs(points - points[0]).max(axis=1)
    reach = min(max(_LEAST_ROUND, float(away[away < _FAR].max())), _MOST_ROUND)
    return np.array([points[0] - reach, points[0] + reach])


def _waypoints(message: LoggedMessage) -> tuple[tuple[Point, ...], float | None]:
    """Return the discs of the waypoints: where they lie, and their radius; there may be none."""
    discs = [entity.cylinders[0] for entity in _scene_update(message).entities if entity.cylinders]
    if not discs:
        return (), None
    places = tuple(
        (round(disc.pose.position.x, 3), round(disc.pose.position.y, 3)) for disc in discs
    )
    return places, 0.5 * discs[0].size.x


def _place(message: LoggedMessage, box: Box, most_bytes: int) -> ReadScene | None:
    ground = 0.0
    parts: list[NDArray[np.float64]] = []
    for entity in _scene_update(message).entities:
        if entity.id == "trail" and entity.lines and entity.lines[0].points:
            ground = entity.lines[0].points[0].z
        elif entity.id.startswith("place/") and entity.id not in _HIDDEN:
            parts += [_corners(triangles) for triangles in entity.triangles]
    triangles = np.concatenate(parts) if parts else np.empty((0, 3, 3))
    picture = picture_from_above(triangles, box, ground=ground, most_bytes=most_bytes)
    return ReadScene(box=box, picture=picture) if picture else None


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
        name = clean(topic, at_most=200)
        clip = clip_of(shown, topic=name, end=end_ns * _SECOND, most_bytes=most_bytes)
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


_PHOTO, _RAW = "foxglove.CompressedImage", "foxglove.RawImage"
_RAW_KINDS = {"16UC1": np.dtype("<u2"), "32FC1": np.dtype("<f4")}
_MOST_KEPT = 64 * 2**20  # bytes of pictures of all cameras that wait for a trial's end
_MOST_PIXELS = 4096 * 4096
_FARTHEST = 30.0  # The grey of what is farthest; only what is nothing is black.
_SECOND = 1e-9  # in a nanosecond


class LatestPictures:
    """Remembers the pictures of the last seconds, camera by camera."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], deque[LoggedMessage]] = {}
        self._bytes = 0

    def take(self, message: LoggedMessage) -> None:
        """Remember a message, if it is a picture, and forget those for which there is no room."""
        if message.kind not in {_PHOTO, _RAW} or not message.topic.startswith("/camera/"):
            return
        self._kept.setdefault((message.kind, message.topic), deque()).append(message)
        self._bytes += len(message.data)
        self._forget(message.time_ns)

    def shown(self, end_ns: int) -> tuple[str, list[tuple[float, Image]]]:
        """Return a topic and its (seconds, picture) until the trial's end; none if there are none.

        Of several cameras a photograph goes before depth, and what has the shorter name first.

        Raises:
            ValueError, OSError, protobuf's errors: a picture is damaged.
        """
        self._forget(end_ns)
        cameras = [key for key, messages in self._kept.items() if messages]
        if not cameras:
            return "", []
        kind, topic = min(cameras, key=lambda key: (key[0], key[1].count("/"), key[1]))
        messages = _thinned(self._kept[kind, topic])
        times = [message.time_ns * _SECOND for message in messages]
        data = [message.data for message in messages]
        pictures = [_photo(each) for each in data] if kind == _PHOTO else _greys(data)
        return topic, list(zip(times, pictures, strict=True))

    def _forget(self, now_ns: int) -> None:
        for messages in self._kept.values():
            while messages and (
                (now_ns - messages[0].time_ns) * _SECOND > SECONDS or self._bytes > _MOST_KEPT
            ):
                self._bytes -= len(messages.popleft().data)


def _thinned(messages: deque[LoggedMessage]) -> list[LoggedMessage]:
    """Return messages that are some time apart, the last of all among them."""
    kept = [messages[-1]]
    for message in reversed(messages):
        if (kept[-1].time_ns - message.time_ns) * _SECOND > 0.99 * PERIOD:
            kept.append(message)
    return kept[::-1]


def _photo(data: bytes) -> Image:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    from nw_base.files.pictures import open_picture

    message = CompressedImage.FromString(data)
    with open_picture(BytesIO(message.data), ("JPEG", "PNG")) as picture:
        _bound(picture.width, picture.height)
        return sized(picture)


def _greys(data: Sequence[bytes]) -> list[Image]:
    """Return pictures of numbers: what is small, or near, is bright, and what is none is black."""
    from PIL.Image import fromarray

    arrays = [_numbers(each) for each in data]
    known = np.concatenate([array[np.isfinite(array)] for array in arrays])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    pictures: list[Image] = []
    for array in arrays:
        near = ((high - array) / max(high - low, 1e-12)).clip(0.0, 1.0)
        grey = np.where(np.isfinite(array), _FARTHEST + (255.0 - _FARTHEST) * near, 0.0)
        pictures.append(sized(fromarray(np.rint(grey).astype(np.uint8))))
    return pictures


def _numbers(data: bytes) -> Any:
    """Return a picture of numbers, (H, W) float64: metres where it is of depth, NaN for none."""
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    message = RawImage.FromString(data)
    _bound(message.width, message.height)
    kind = _RAW_KINDS.get(message.encoding)
    if kind is None or len(message.data) != message.width * message.height * kind.itemsize:
        raise ValueError("a picture is damaged")
    numbers = np.frombuffer(message.data, kind).reshape(message.height, message.width)
    numbers = numbers.astype(np.float64)
    return np.where(numbers > 0, numbers, np.nan) if message.encoding == "16UC1" else numbers


def _bound(width: int, height: int) -> None:
    if not 0 < width * height <= _MOST_PIXELS:
        raise ValueError(f"a picture has {width} x {height} pixels")


SECONDS = 3.0
"""Of simulated time that a clip shows; a fall takes one."""

PERIOD = 0.1
"""Seconds between two of its pictures, at the least."""

_HOLD = 1200  # ms that the last picture stands
_LARGE, _SMALL = 256, 160  # pixels of the longer side: pictures shrink to it, or grow towards it
# Quality, and of how many pictures one is kept: the first attempt that fits.
_ATTEMPTS = ((60, 1), (35, 1), (15, 1), (15, 2), (15, 4))


def clip_of(
    pictures: Sequence[tuple[float, Image]], *, topic: str, end: float, most_bytes: int
) -> ReadClip | None:
    """Return a clip, or None if it fits in no quality.

    Args:
        pictures: (seconds, image as `sized` gives it) in the order of time, at least one.
        topic: where they are in the log.
        end: of the trial, s: clips that begin at one time begin again at one time.
        most_bytes: of the clip and its last picture together.
    """
    last = pictures[-1][1]
    frames = [(time, picture.resize(last.size)) for time, picture in pictures]
    for quality, step in _ATTEMPTS:
        kept = frames[::-1][::step][::-1]  # The last one stays.
        data, still = _webp(kept, quality, end=end), _webp(kept[-1:], quality, end=end)
        if len(data) + len(still) <= most_bytes:
            return ReadClip(
                data=data,
                still=still,
                width=last.width,
                height=last.height,
                topic=topic,
                seconds=round(kept[-1][0] - kept[0][0], 3),
            )
    return None


def sized(picture: Image) -> Image:
    """Return a picture in colours, about as large as a page shows it."""
    from PIL.Image import Resampling

    side = max(picture.size)
    grow = max(1, _SMALL // side)
    scale = grow * min(1.0, _LARGE / side)
    width, height = (max(1, round(pixels * scale)) for pixels in picture.size)
    how = Resampling.NEAREST if grow > 1 else Resampling.BOX
    return picture.convert("RGB").resize((width, height), how)


def _webp(frames: Sequence[tuple[float, Image]], quality: int, *, end: float) -> bytes:
    times = [*(time for time, _ in frames), end]
    stands = [round(1000 * (later - time)) for time, later in pairwise(times)]
    stands[-1] += _HOLD
    others = [image for _, image in frames[1:]]
    return webp(frames[0][1], quality, save_all=True, append_images=others, duration=stands, loop=0)


def webp(picture: Image, quality: int, **options: Any) -> bytes:
    """Return a picture as WebP, with options of Pillow."""
    # It is registered by that; to find it, Pillow would import all the formats that it knows.
    from PIL import WebPImagePlugin  # noqa: F401 # pyright: ignore[reportUnusedImport]

    file = BytesIO()
    picture.save(file, "WEBP", quality=quality, **options)
    return file.getvalue()


Box = tuple[float, float, float, float]
"""West, south, east, north: metres in the world frame."""

MARGIN = 2.0
"""Metres round the course; a robot that is farther from it is off its course."""

_SIDE = 480  # pixels of the longer side
_FINER = 2  # It is drawn so many times larger, and then made smaller for smooth edges.
_MOST_TRIANGLES = 300_000  # in the picture; those of the built-in scenes have some thousand
# Heights against the ground at the start, m, and their greys: pits are dark, and what stands up is
# darker the higher it is. Obstacles of a legged robot are low, so most greys are spent on those.
_HEIGHTS, _GREYS = (-0.6, 0.0, 0.3, 1.2), (120, 232, 176, 104)
_LEANS = 0.2  # of its grey that a vertical face loses
_QUALITIES = (60, 30, 10)


def box_round(points: NDArray[np.floating]) -> Box:
    """Return the box of some points, (n, 2) m, with a margin."""
    west, south = (points.min(axis=0) - MARGIN).tolist()
    east, north = (points.max(axis=0) + MARGIN).tolist()
    return west, south, east, north


def picture_from_above(
    triangles: NDArray[np.floating], box: Box, *, ground: float, most_bytes: int
) -> bytes:
    """Return a WebP of a mesh; empty where there is nothing to draw, or no room for it.

    Args:
        triangles: corners, (n, 3, 3) m, of all but what hangs overhead.
        box: what the picture shows.
        ground: height of the start, m.
        most_bytes: that the file may have.
    """
    from PIL import Image, ImageDraw

    west, south, east, north = box
    seen = _seen(triangles, box)
    if not 0 < len(seen) <= _MOST_TRIANGLES:
        return b""
    scale = _FINER * _SIDE / max(east - west, north - south)  # pixels in a metre
    width, height = ((east - west) * scale, (north - south) * scale)
    picture = Image.new("L", (max(_FINER, round(width)), max(_FINER, round(height))), 255)
    brush = ImageDraw.Draw(picture)
    corners = (seen[:, :, :2] - (west, north)) * (scale, -scale)
    # The painter's way: what lies lower first. Faces of a scene hardly cut through each other.
    for corner, grey in zip(
        corners.reshape(-1, 6).tolist(), _heights_as_greys(seen, ground).tolist(), strict=True
    ):
        brush.polygon(corner, fill=grey)
    small = picture.reduce(_FINER)
    for quality in _QUALITIES:
        if len(data := webp(small, quality)) <= most_bytes:
            return data
    return b""


def _seen(triangles: NDArray[np.floating], box: Box) -> NDArray[np.floating]:
    """Return the triangles that lie in the box, the lower ones first; walls have no area there."""
    west, south, east, north = box
    flat = triangles[:, :, :2]
    near = (flat.min(axis=1) < (east, north)).all(axis=1)
    near &= (flat.max(axis=1) > (west, south)).all(axis=1)
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    visible = triangles[near & (area > 1e-6) & np.isfinite(triangles).all(axis=(1, 2))]
    return visible[np.argsort(visible[:, :, 2].mean(axis=1), kind="stable")]


def _heights_as_greys(triangles: NDArray[np.floating], ground: float) -> NDArray[np.int64]:
    """Return a grey for each triangle, by its height and, a little, by how it leans."""
    grey = np.interp(triangles[:, :, 2].mean(axis=1) - ground, _HEIGHTS, _GREYS)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    return np.rint(grey * (1.0 - _LEANS * (1.0 - level))).astype(np.int64)
