"""What a policy saw: camera frames as Foxglove messages, and its rows of numbers as our own.

Frames and rows are read back here too. Rows are `nw.Observation` messages.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from math import prod
from typing import Any, Literal, NamedTuple, assert_never

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from numpy.typing import NDArray
from PIL import Image as PillowImage

from nw_base.clean import clean
from nw_base.files.pictures import open_picture
from nw_base.lens import Intrinsics
from nw_sim.rollout.mcap.batch import BLANK_TIME, Form
from nw_sim.rollout.mcap.messages import Observation, Term, stamp

PixelForm = Literal["photo", "drawing", "grey", "classes", "metres", "numbers"]
"""What a pixel is, and how it is kept: sRGB bytes as JPEG; sRGB bytes of few colours as PNG; a byte
of brightness as JPEG; a class of `sensors.drawing.pictures` as PNG with that palette; metres as
whole millimetres in 16 bits; any number as it is in 32 bits."""

MILLIMETRES = 1000.0
"""In a metre. A depth of 0 is none: the ray met nothing, or farther than 65.534 m."""

_QUALITY = 90
_FARTHEST = 65534  # mm
_MOST_PIXELS = 4096 * 4096


def image_message(
    time_ns: int, frame_id: str, image: NDArray[Any], form: PixelForm = "photo"
) -> CompressedImage | RawImage:
    """Return a frame.

    Args:
        time_ns: simulated time.
        frame_id: the camera's frame in `/tf`.
        image: (H, W, 3) uint8 of a photo or drawing, (H, W) of the other forms.
        form: what its pixels are.
    """
    when = stamp(time_ns)
    match form:
        case "metres":
            metres = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)
            whole = np.rint(metres * MILLIMETRES)
            near = np.where((whole > 0) & (whole <= _FARTHEST), whole, 0).astype("<u2")
            return _raw(when, frame_id, "16UC1", near)
        case "numbers":
            return _raw(when, frame_id, "32FC1", image.astype("<f4"))
        case "photo" | "grey":
            name, data = "jpeg", _file(image, "JPEG", quality=_QUALITY)
        case "drawing":
            name, data = "png", _file(image, "PNG")
        case "classes":
            # Sensors load the simulator, which reading a log must not.
            from nw_sim.sensors.drawing.pictures import PALETTE

            name, data = "png", _file(image, "PNG", palette=PALETTE.tobytes())
        case _:
            assert_never(form)
    return CompressedImage(timestamp=when, frame_id=frame_id, format=name, data=data)


def _file(image: NDArray[Any], kind: str, *, palette: bytes | None = None, **options: int) -> bytes:
    picture = PillowImage.fromarray(np.ascontiguousarray(image))
    if palette is not None:
        picture.putpalette(palette)
    file = BytesIO()
    picture.save(file, kind, **options)
    return file.getvalue()


def image_of(message: CompressedImage | RawImage) -> NDArray[Any]:
    """Return a frame's pixels: (H, W, 3) or (H, W) uint8, or (H, W) float32, metres where 16UC1.

    Raises:
        ValueError: the frame is damaged, or larger than any of ours.
    """
    if isinstance(message, RawImage):
        return _pixels(message)
    try:
        with open_picture(BytesIO(message.data), ("JPEG", "PNG")) as image:
            _bound(image.width, image.height)
            is_ours = image.mode in {"L", "P", "RGB"}
            return np.asarray(image if is_ours else image.convert("RGB"))
    except (OSError, PillowImage.DecompressionBombError) as error:
        raise ValueError(f"a picture is damaged: {clean(error, at_most=100)}") from None


def calibration_message(time_ns: int, frame_id: str, lens: Intrinsics) -> CameraCalibration:
    """Return the calibration of a camera, with distortion in ROS' words.

    Args:
        time_ns: simulated time.
        frame_id: the camera's frame in `/tf`.
        lens: of the pictures.
    """
    fx, fy, cx, cy, bent = lens.fx, lens.fy, lens.cx, lens.cy, lens.distortion
    bends = [] if bent is None else list(bent.coefficients)
    if bent is not None and bent.model == "fisheye":
        model = "kannala_brandt"
    else:
        bends += [0.0] * (5 - len(bends))
        model = "plumb_bob" if len(bends) == 5 else "rational_polynomial"
    return CameraCalibration(
        timestamp=stamp(time_ns),
        frame_id=frame_id,
        width=lens.width,
        height=lens.height,
        distortion_model=model,
        D=bends,
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _raw(when: Any, frame_id: str, encoding: str, image: NDArray[Any]) -> RawImage:
    height, width = image.shape
    return RawImage(
        timestamp=when,
        frame_id=frame_id,
        width=width,
        height=height,
        encoding=encoding,
        step=width * image.itemsize,
        data=image.tobytes(),
    )


def _pixels(message: RawImage) -> NDArray[np.float32]:
    width, height = message.width, message.height
    _bound(width, height)
    kind = {"16UC1": np.dtype("<u2"), "32FC1": np.dtype("<f4")}.get(message.encoding)
    if kind is None or len(message.data) != width * height * kind.itemsize:
        raise ValueError(f"a picture is damaged: {len(message.data)} bytes for {width} x {height}")
    pixels = np.frombuffer(message.data, kind).reshape(height, width)
    if message.encoding == "16UC1":
        return (pixels / MILLIMETRES).astype(np.float32)
    return pixels.astype(np.float32)


def _bound(width: int, height: int) -> None:
    if not 0 < width * height <= _MOST_PIXELS:
        raise ValueError(f"a picture has {width} x {height} pixels")


Rows = NDArray[np.uint8]
# Bits of floats that stand for what is filled in. All four bytes of none lie across two others.
_BLANK = 0x7F000000


Terms = tuple[tuple[str, int], ...]
"""Name and number of values of each part of an observation, in their order."""


class SeenRow(NamedTuple):
    """An observation that is a row of numbers, as the log has it."""

    topic: str
    shape: tuple[int, ...]
    terms: Terms


def observation_digest(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the SHA-256 of observations: names in order, types, shapes and bytes."""
    total = sha256()
    for name in sorted(observation):
        array = np.ascontiguousarray(observation[name])
        total.update(_title(name, array.dtype, array.shape))
        total.update(array.data)
    return total.digest()


class SeenRows:
    """The observations of one policy that are rows of numbers, noted as bytes.

    Args:
        rows: by name, in the order in which they are given.
        is_all: whether the policy is given nothing else.
    """

    def __init__(self, rows: Mapping[str, SeenRow], *, is_all: bool) -> None:
        self._rows = rows
        self._is_all = is_all
        # Where each lies in the bytes, its type and shape: the same in every step.
        self._places: dict[str, tuple[slice, np.dtype[Any], tuple[int, ...]]] = {}

    def note(self, observation: Mapping[str, NDArray[Any]]) -> tuple[bytes, Iterable[bytes]]:
        """Return the digest of all observations, and the bytes of each row among them.

        The digest is empty where it follows from those bytes: see `digests`.
        """
        if not observation:
            return _NOTHING, ()
        digest, rows = b"", observation
        if not self._is_all:
            digest = observation_digest(observation)
            rows = {name: observation[name] for name in self._rows}
        if not self._places:
            self._place(rows)
        return digest, map(np.ndarray.tobytes, rows.values())

    def digests(self, noted: Sequence[bytes]) -> list[bytes]:
        """Return the `observation_digest` of N steps, of which the joined rows were noted."""
        rows = stacked_bytes(noted)
        parts: list[Rows] = []
        for name in sorted(self._places):
            place, kind, shape = self._places[name]
            title = np.frombuffer(_title(name, kind, shape), np.uint8)
            parts += np.broadcast_to(title, (len(rows), len(title))), rows[:, place]
        return [sha256(row).digest() for row in np.concatenate(parts, axis=1)]

    def numbers(
        self, new: Sequence[bool], noted: Sequence[bytes]
    ) -> tuple[dict[str, Form], list[NDArray[np.float32]]]:
        """Return the forms of rows by topic, and what is filled in, (N, ...) each.

        Args:
            new: which rows are wanted.
            noted: the joined rows of N steps.
        """
        forms: dict[str, Form] = {}
        numbers: list[NDArray[np.float32]] = []
        rows = stacked_bytes(noted) if any(new) else np.empty((0, 0), np.uint8)
        for (name, row), is_new in zip(self._rows.items(), new, strict=True):
            if is_new:
                place, kind, _ = self._places[name]
                forms[row.topic] = observation_form(row.shape, row.terms)
                values = np.ascontiguousarray(rows[:, place]).view(kind)
                numbers.append(values.astype("<f4", copy=False))
        return forms, numbers

    def _place(self, rows: Mapping[str, NDArray[Any]]) -> None:
        start = 0
        for name, array in rows.items():
            end = start + array.nbytes
            self._places[name] = slice(start, end), array.dtype, np.ascontiguousarray(array).shape
            start = end


def stacked_bytes(noted: Sequence[bytes]) -> Rows:
    """Return bytes of one length as rows."""
    return np.frombuffer(b"".join(noted), np.uint8).reshape(len(noted), -1)


@lru_cache(maxsize=256)  # They are the same in every control step.
def _title(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {kind.str} {shape}".encode()


_NOTHING = observation_digest({})


@lru_cache(maxsize=32)
def observation_form(shape: tuple[int, ...], terms: Terms) -> Form:
    """Return the form of an observation: float32, last axis fastest, by terms.

    Args:
        shape: of the observation, with some thousand numbers at most.
        terms: its parts.

    Raises:
        ValueError: there are too many numbers for a form.
    """
    blanks: list[bytes] = []
    first = _BLANK
    message = Observation(timestamp=BLANK_TIME, shape=shape)
    for name, size in terms:
        blank = np.arange(first, first + size, dtype="<u4")
        first += size
        blanks.append(blank.tobytes())
        message.terms.append(Term(name=name, values=blank.view("<f4").tolist()))
    return Form(message, blanks)


def observation_message(time_ns: int, name: str, array: NDArray[Any]) -> Any:
    """Return an observation of any size, as one term of its own name."""
    term = Term(name=name, values=array.ravel().astype(np.float32).tolist())
    return Observation(timestamp=stamp(time_ns), shape=array.shape, terms=[term])


def values_of(message: Any) -> NDArray[np.float32]:
    """Return an observation's numbers in its shape.

    Raises:
        ValueError: it is damaged.
    """
    parts = [np.array(term.values, np.float32) for term in message.terms]
    values = np.concatenate(parts) if parts else np.empty(0, np.float32)
    if values.size != prod(message.shape):
        raise ValueError(f"an observation of {tuple(message.shape)} has {values.size} numbers")
    return values.reshape(tuple(message.shape))
