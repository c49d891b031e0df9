"""Frames into an MP4, through the ffmpeg that the user has."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from nw_eval.errors import PrerequisiteError, SceneError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.splat.image import Image


def save_mp4(path: Path, images: Iterable[Image], *, rate: float = 24.0) -> None:
    """Write images of one size as H.264 video of `rate` frames a second.

    Raises:
        PrerequisiteError: there is no ffmpeg.
        SceneError: there is no image, or ffmpeg cannot write the file.
    """
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise PrerequisiteError(
            f"writing {path} needs ffmpeg", fix="install ffmpeg, or name a .gif instead"
        )
    frames = iter(images)
    first = next(frames, None)
    if first is None:
        raise SceneError(f"{path}: no frame to write", fix="ask for at least one frame")
    height, width, _ = first.bytes().shape
    with atomic_path(followed(path)) as temporary:
        command = [ffmpeg, "-loglevel", "error", "-y"]
        command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        command += ["-r", f"{rate:g}", "-i", "-", "-an", "-c:v", "libx264"]
        # Players want even sides and 4:2:0.
        command += ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", "-pix_fmt", "yuv420p"]
        data = b"".join(image.bytes().tobytes() for image in chain([first], frames))
        done = subprocess.run(  # noqa: S603 - fixed arguments, no shell.
            [*command, "-f", "mp4", str(temporary)], input=data, capture_output=True, check=False
        )
        if done.returncode != 0:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            raise SceneError(
                f"{path}: ffmpeg failed: {lines[-1] if lines else done.returncode}",
                fix="name a .gif instead",
            )
