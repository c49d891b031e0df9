"""`nw-eval splat`: look into files of Gaussians, convert them, and draw them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_splat.files.convert import WrittenSplat
    from nw_splat.gaussians import SplatFigures


@verb_of("splat_info")
class Info(Printed, Verb):
    """Show the contents of a splat: counts, bounds, harmonics, sizes, opacities."""

    def show(self, result: SplatFigures) -> str:
        from nw_splat.cli import splat_page

        return splat_page(result)


@verb_of("splat_convert", flags=("out",))
class Convert(Verb):
    """Convert a Gaussian-splat file to .ply, gsplat .pt (exact), .spz or .splat (lossy)."""

    def show(self, result: WrittenSplat) -> str:
        from nw_splat.cli import written_line

        return written_line(result)


@verb_of(
    "splat_render",
    flags=("out",),
    without=("size",),
    named={"backend": "render"},
    metavars={"eye": "X Y Z", "target": "X Y Z"},
)
class Render(Verb):
    """Render a splat: a PNG from one pose, or a turntable as GIF or MP4.

    In a built-in scene the camera follows the course.
    """

    out = Path("splat.png")
    width: int = 640
    """Pixels across."""
    height: int = 360
    """Pixels down."""

    def more(self) -> dict[str, Any]:
        return {"size": (self.width, self.height)}
