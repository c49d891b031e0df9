"""`nw-eval splat`: look into files of Gaussians, convert them, and draw them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from nw_base.words import Backend, Projection, UpAxis

Point = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]


@dataclass(frozen=True, kw_only=True)
class Info:
    """Say what a splat holds: counts, bounds, harmonics, sizes, opacities."""

    source: tyro.conf.Positional[str]
    """3DGS or compressed PLY, SPZ, SOG, .splat, gsplat .pt, a nerfstudio export's folder, a file of
    nw-eval's cache, or the name of a built-in scene."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_splat.cli import splat_page

        print(splat_page(api.splat_info(self.source)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Convert:
    """Write Gaussians as another file: .ply, gsplat .pt (exact), .spz or .splat (lossy)."""

    source: tyro.conf.Positional[str]
    """A file of Gaussians, or the name of a built-in scene, which comes in world metres."""
    out: Path
    """What to write; its suffix says the format."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_splat.cli import written_line

        print(written_line(api.splat_convert(self.source, self.out)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Render:
    """Draw a splat: a PNG from a pose, or a turn around it as GIF or MP4.

    In a built-in scene the camera goes round the course, within the walls.
    """

    source: tyro.conf.Positional[str]
    """A file of Gaussians, or the name of a built-in scene."""
    out: Path = Path("splat.png")
    """What to write: .png, .gif or .mp4."""
    width: int = 640
    """Pixels across."""
    height: int = 360
    """Pixels down."""
    up: UpAxis = "-y"
    """Upward axis of a file; built-in scenes have +z."""
    eye: Point = None
    """Where the camera stands, and a turn looks round from; chosen when absent."""
    target: Point = None
    """What a PNG's camera looks at; needs --eye."""
    frames: int = 48
    """Frames of a turn."""
    render: Backend = "cpu"
    """The renderer. There is no silent fallback."""
    projection: Projection = "ray"
    """How Gaussians become pixels: each along the pixel's own ray, or by EWA as gsplat does."""

    def __call__(self) -> int:
        from nw_eval import api

        picture = api.splat_render(
            self.source,
            self.out,
            size=(self.width, self.height),
            up=self.up,
            eye=self.eye,
            target=self.target,
            frames=self.frames,
            backend=self.render,
            projection=self.projection,
        )
        print(picture)
        return 0
