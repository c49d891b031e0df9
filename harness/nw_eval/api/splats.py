"""Files of Gaussians: looked into, converted, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError

if TYPE_CHECKING:
    from nw_eval.rollout.job import Backend
    from nw_eval.splat.turntable import Up

_EYE_HEIGHT = 0.3
"""Metres above the ground at which a quadruped's camera looks at a scene."""


def splat_info(path: Path) -> str:
    """Return what a file of Gaussians holds, in lines of text.

    Raises:
        SceneError: it cannot be read.
    """
    from nw_eval.splat.describe import describe
    from nw_eval.splat.files import read_splat

    return "\n".join(describe(read_splat(path)).lines())


def splat_convert(path: Path, out: Path) -> str:
    """Write the Gaussians of one file as another, and return what was written, in words.

    Raises:
        SceneError: the file cannot be read, or its Gaussians do not fit the new format.
        UsageError: a format that cannot be written.
    """
    from nw_eval.splat.files import read_splat, write_splat

    gaussians = read_splat(path)
    write_splat(out, gaussians)
    return f"{out}: {len(gaussians):,} Gaussians, {out.stat().st_size / 2**20:.1f} MiB"


def splat_render(
    source: str,
    out: Path,
    *,
    size: tuple[int, int] = (640, 360),
    up: Up = "-y",
    eye: tuple[float, float, float] | None = None,
    target: tuple[float, float, float] | None = None,
    frames: int = 48,
    backend: Backend = "cpu",
) -> None:
    """Draw a file of Gaussians or a built-in scene: PNG from a pose, a turn as GIF or MP4.

    Args:
        source: path of a file, or a scene's name.
        out: .png, .gif or .mp4.
        size: pixels across and down.
        up: upward axis of a file's frame; scenes have +z.
        eye: where the camera stands, in the splat's own frame; chosen if None.
        target: what it looks at; the middle of a file, or straight ahead in a scene, if None.
        frames: of a turn: around a file, or on the spot in a scene.
        backend: the renderer.

    Raises:
        SceneError, UsageError, PrerequisiteError: something cannot be read, drawn or written.
    """
    from nw_eval import scenes
    from nw_eval.splat import portrait

    suffix = out.suffix.lower()
    if suffix not in portrait.SUFFIXES:
        known = ", ".join(portrait.SUFFIXES)
        raise UsageError(f"{out}: cannot draw {suffix or 'nothing'!r}", fix=f"name one of {known}")
    if target is not None and eye is None:
        raise UsageError("--target without --eye", fix="say where the camera stands too")
    if source in scenes.names():
        scene = scenes.get_scene(source)
        x, y, z = scene.spawn.position
        subject = portrait.of_store(scene.splat_store(), stand=(x, y, z + _EYE_HEIGHT))
    else:
        subject = portrait.of_file(Path(source), up=up)
    subject.draw(out, size=size, eye=eye, target=target, frames=frames, backend=backend)
