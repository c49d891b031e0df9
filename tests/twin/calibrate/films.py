"""Films that a test takes frames of, and photographs that were taken in."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from nw_twin.calibrate.photographs import Photograph

_MILLISECOND = Fraction(1, 1000)


def film(path, frames, *, rate=15, codec="mpeg4", form="yuv420p", times=None, **options):
    """Write a film of frames: pictures (H, W, 3) uint8, or frames of PyAV.

    Args:
        path: whose suffix is the container's.
        frames: of one size.
        rate: that the header names, a second.
        codec, form: of FFmpeg; the pixels' format.
        times: of each frame, milliseconds; None = as the rate says.
        options: of the codec.
    """
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.pix_fmt, stream.options = form, options
        for number, shown in enumerate(frames):
            frame = shown
            if isinstance(shown, np.ndarray):
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(shown), format="rgb24")
            if number == 0:
                stream.width, stream.height = frame.width, frame.height
                if times is not None:
                    stream.codec_context.time_base = _MILLISECOND
            if times is not None:
                frame.pts, frame.time_base = times[number], _MILLISECOND
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def photograph(name="a.png", **facts):
    """Return one of 640 x 480 pixels that is sharp and bright, but for some facts."""
    usual = {"file": f"{name}.jpg", "path": Path(f"{name}.jpg"), "mask": None, "focal": None}
    usual |= {"width": 640, "height": 480, "sharpness": 100.0, "contrast": 50.0}
    return Photograph(**{**usual, "name": name, "brightness": 120.0} | facts)
