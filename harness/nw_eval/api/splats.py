"""Files of Gaussians: looked into, converted, drawn."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import SceneError, nearest
from nw_base.files.inside import what_is
from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_base.words import Backend, Projection, UpAxis
    from nw_splat.files.convert import WrittenSplat
    from nw_splat.gaussians import Gaussians, SplatFigures

_EYE_HEIGHT = 0.3
"""Metres above the ground at which a quadruped's camera looks at a scene."""


def splat_info(source: str | Path) -> SplatFigures:
    """Return what a file of Gaussians or a built-in scene holds: counts, bounds, sizes, opacities.

    Args:
        source: 3DGS or compressed PLY, SPZ, SOG, .splat, gsplat .pt, a nerfstudio export folder, a
            file of nw-eval's cache, or the name of a built-in scene.

    Raises:
        SceneError: it cannot be read.
    """
    from nw_splat.gaussians import describe

    return describe(_gaussians(source))


def splat_convert(source: str | Path, out: str | PathLike[str]) -> WrittenSplat:
    """Write the Gaussians of a file or of a built-in scene.

    Args:
        source: a Gaussian-splat file, or the name of a built-in scene (in world metres).
        out: the file to write; its suffix selects the format.

    Raises:
        SceneError: they cannot be read, or do not fit the new format.
        UsageError: a format that cannot be written.
    """
    from nw_splat.files.convert import write_new

    out = as_path(out)
    return write_new(out, _gaussians(source))


def splat_render(
    source: str,
    out: str | PathLike[str],
    *,
    size: tuple[int, int] = (640, 360),
    up: UpAxis = "-y",
    eye: tuple[float, float, float] | None = None,
    target: tuple[float, float, float] | None = None,
    frames: int = 48,
    backend: Backend = "cpu",
    projection: Projection = "ray",
) -> Path:
    """Draw a file of Gaussians or a built-in scene, and return the path of the picture.

    A PNG is a still from one pose, a GIF or MP4 a turn.

    Args:
        source: a Gaussian-splat file, or the name of a built-in scene.
        out: the file to write: .png, .gif or .mp4.
        size: pixels across and down.
        up: up axis of a file; built-in scenes use +z.
        eye: camera position, or start of a turn, in the file's frame or the scene's world (default:
            chosen).
        target: point that a PNG's camera looks at; needs --eye (default: the middle of a file, or
            straight ahead in a scene).
        frames: frames of a turn around a file, or along a scene's course.
        backend: the renderer; it never falls back to another one.
        projection: how Gaussians are projected: ray evaluates each along the pixel's ray; ewa
            approximates as gsplat does.

    Raises:
        SceneError: the source cannot be read.
        UsageError: what `out` is called says no format, or `target` is given without `eye`.
        PrerequisiteError: the renderer, or the MP4 writer, is not installed.
        StoreError: the picture cannot be written.
    """
    from nw_scenes.overview import circuit
    from nw_sim import catalogue
    from nw_splat import portrait

    out = as_path(out)
    portrait.check(out, eye, target)
    gaussians = _gaussians(source)
    if catalogue.is_built_in(str(source)):
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
    subject.draw(
        out,
        size=size,
        eye=eye,
        target=target,
        frames=frames,
        backend=backend,
        projection=projection,
    )
    return out


def _gaussians(source: str | Path) -> Gaussians:
    """Return the Gaussians of a file, in its own frame, or of a built-in scene, in the world's."""
    from nw_sim import catalogue
    from nw_splat.files import read_splat
    from nw_splat.gaussians import transformed

    name = str(source)
    if catalogue.is_built_in(name):
        scene = catalogue.get_scene(name)
        return transformed(read_splat(scene.splat_store()), scene.T_world_splat)
    path = Path(source)
    if not path.suffix and what_is(path) == "nothing":
        raise SceneError(
            f"no file and no built-in scene is called {name!r}",
            fix=nearest(name, catalogue.names()),
        )
    return read_splat(path)
