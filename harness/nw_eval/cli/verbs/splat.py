"""`nw-eval splat`: look into files of Gaussians, convert them, and draw them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_base.words import Backend, Projection, UpAxis

if TYPE_CHECKING:
    from nw_eval.api import WrittenSplat
    from nw_splat.gaussians import SplatFigures

Point = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]


@dataclass(frozen=True, kw_only=True)
class Info:
    """Say what a splat holds: counts, bounds, harmonics, sizes, opacities."""

    source: tyro.conf.Positional[str]
    """3DGS or compressed PLY, SPZ, SOG, .splat, gsplat .pt, a nerfstudio export's folder, a file of
    nw-eval's cache, or the name of a built-in scene."""

    def __call__(self) -> int:
        from nw_eval import api

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

        written = api.splat_convert(self.source, self.out)
        print("\n".join([*(f"note: {note}" for note in written.notes), written_line(written)]))
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


_BAR = 40
"""Characters of the longest bar of the histogram."""


def splat_page(figures: SplatFigures) -> str:
    """Return all figures of a set of Gaussians, the histogram of opacities as bars."""
    most = max(*figures.opacity_histogram, 1)
    seen, broken = f"{figures.visible:,} visible", f"{figures.not_finite:,} cannot be drawn"
    lines = [
        f"Gaussians  {figures.count:,} ({seen}, {broken})",
        f"harmonics  degree {figures.sh_degree}",
        f"drawn      {figures.rasterize_mode or 'antialiased (the file does not say)'}",
        *([] if figures.projection is None else [f"trained    by {figures.projection}"]),
        f"bounds     {_box(figures.bounds)}",
        f"bulk (98%) {_box(figures.bulk)}",
        "size       1% {:.4g}, median {:.4g}, 99% {:.4g}".format(*figures.scale_percentiles),
        "opacity",
    ]
    for i, number in enumerate(figures.opacity_histogram):
        bar = "#" * round(_BAR * number / most)
        lines.append(f"  {i / 10:.1f}-{(i + 1) / 10:.1f} {number:>10,} {bar}".rstrip())
    lines += [f"note       {note}" for note in figures.notes]
    return "\n".join(lines)


def written_line(splat: WrittenSplat) -> str:
    """Return what was written, and how large it is."""
    left = f", {splat.left_out:,} that cannot be drawn left out" if splat.left_out else ""
    return f"{splat.file}: {splat.gaussians:,} Gaussians, {splat.bytes / 2**20:.1f} MiB{left}"


def _box(corners: tuple[tuple[float, ...], tuple[float, ...]]) -> str:
    low, high = corners
    return "  ".join(
        f"{axis} {a:.3f} to {b:.3f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
