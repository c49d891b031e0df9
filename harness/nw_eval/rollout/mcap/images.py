"""Camera frames and calibrations as Foxglove messages."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from PIL import Image as PillowImage

from nw_eval.rollout.mcap.stamps import stamp

_QUALITY = 90


def image_message(time_ns: int, frame_id: str, rgb: np.ndarray) -> Any:
    """Return a frame as JPEG.

    Args:
        time_ns: simulated time.
        frame_id: the camera's frame in `/tf`.
        rgb: (H, W, 3) uint8.
    """
    file = BytesIO()
    PillowImage.fromarray(np.ascontiguousarray(rgb)).save(file, "JPEG", quality=_QUALITY)
    return CompressedImage(
        timestamp=stamp(time_ns), frame_id=frame_id, format="jpeg", data=file.getvalue()
    )


def calibration_message(
    time_ns: int, frame_id: str, *, width: int, height: int, fovy: float
) -> Any:
    """Return the calibration of a pinhole camera with square pixels and no distortion.

    Args:
        time_ns: simulated time.
        frame_id: the camera's frame in `/tf`.
        width: pixels.
        height: pixels.
        fovy: vertical field of view, rad.
    """
    focal = 0.5 * height / float(np.tan(0.5 * fovy))
    cx, cy = 0.5 * width, 0.5 * height
    return CameraCalibration(
        timestamp=stamp(time_ns),
        frame_id=frame_id,
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[focal, 0.0, cx, 0.0, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
