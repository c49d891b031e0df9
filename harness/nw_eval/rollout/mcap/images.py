"""Camera frames and calibrations as Foxglove messages, and frames read back."""

from __future__ import annotations

from io import BytesIO
from typing import Any, Literal, assert_never

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from numpy.typing import NDArray
from PIL import Image as PillowImage

from nw_eval.clean import clean
from nw_eval.files.pictures import open_picture
from nw_eval.lens import Intrinsics
from nw_eval.rollout.mcap.messages import stamp
from nw_eval.sensors.drawing.palette import PALETTE

Form = Literal["photo", "drawing", "grey", "classes", "metres", "numbers"]
"""What a pixel is, and how it is kept: sRGB bytes as JPEG; sRGB bytes of few colours as PNG; a byte
of brightness as JPEG; a class of `sensors.drawing.palette` as PNG with that palette; metres as
whole millimetres in 16 bits; any number as it is in 32 bits."""

MILLIMETRES = 1000.0
"""In a metre. A depth of 0 is none: the ray met nothing, or farther than 65.534 m."""

_QUALITY = 90
_FARTHEST = 65534  # mm
_MOST_PIXELS = 4096 * 4096


def image_message(
    time_ns: int, frame_id: str, image: NDArray[Any], form: Form = "photo"
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
