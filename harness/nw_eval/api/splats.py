"""Files of Gaussians: looked into, converted, drawn."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import SceneError, UsageError, nearest
from nw_eval.inside import what_is

if TYPE_CHECKING:
    from nw_eval.rollout.job import Backend
    from nw_eval.splat.gaussians import Gaussians
    from nw_eval.splat.movies.turntable import Up

_EYE_HEIGHT = 0.3
"""Metres above the ground at which a quadruped's camera looks at a scene."""


def splat_info(source: str | Path) -> str:
    """Return what a file of Gaussians or a built-in scene holds, in lines of text.

    Raises:
        SceneError: it cannot be read.
    """
    from nw_eval.splat.describe import describe

    return "\n".join(describe(_gaussians(source)).lines())


def splat_convert(source: str | Path, out: Path) -> str:
    """Write the Gaussians of a file or of a built-in scene, and return what was written, in words.

    Raises:
        SceneError: they cannot be read, or do not fit the new format.
        UsageError: a format that cannot be written.
    """
    from nw_eval.splat.files import write_splat

    gaussians = _gaussians(source)
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
        source: path of a file, or a built-in scene's name.
        out: .png, .gif or .mp4.
        size: pixels across and down.
        up: upward axis of a file's frame; scenes have +z.
        eye: where the camera stands, in the file's own frame or the scene's world; chosen if None.
            A turn then looks round from there.
        target: what a still looks at; the middle of a file, or straight ahead in a scene, if None.
        frames: of a turn: around a file, or round a scene's trail within its walls.
        backend: the renderer.

    Raises:
        SceneError, UsageError, PrerequisiteError: something cannot be read, drawn or written.
    """
    from nw_eval import catalogue
    from nw_eval.scenes.circuit import circuit
    from nw_eval.splat.movies import portrait

    suffix = out.suffix.lower()
    if suffix not in portrait.SUFFIXES:
        known = ", ".join(portrait.SUFFIXES)
        raise UsageError(f"{out}: cannot draw {suffix or 'nothing'!r}", fix=f"name one of {known}")
    if target is not None and eye is None:
        raise UsageError("--target without --eye", fix="say where the camera stands too")
    gaussians = _gaussians(source)
    if source in catalogue.names():
        scene = catalogue.get_scene(source)
        x, y, z = scene.spawn.position
        subject = portrait.Subject(
            gaussians=gaussians,
            up="+z",
            stand=(x, y, z + _EYE_HEIGHT),
            circuit=partial(circuit, scene),
        )
    else:
        subject = portrait.Subject(gaussians=gaussians, up=up)
    subject.draw(out, size=size, eye=eye, target=target, frames=frames, backend=backend)


def _gaussians(source: str | Path) -> Gaussians:
    """Return the Gaussians of a file, in its own frame, or of a built-in scene, in the world's."""
    from nw_eval import catalogue
    from nw_eval.splat.files import read_splat
    from nw_eval.splat.transform import transformed

    name = str(source)
    if name in catalogue.names():
        scene = catalogue.get_scene(name)
        return transformed(read_splat(scene.splat_store()), scene.T_world_splat)
    path = Path(source)
    if not path.suffix and what_is(path) == "nothing":
        raise SceneError(
            f"no file and no built-in scene is called {name!r}",
            fix=nearest(name, catalogue.names()),
        )
    return read_splat(path)
