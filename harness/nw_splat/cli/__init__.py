"""`nw-splat info|convert|render`: look into files of Gaussians, convert them, and draw them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from nw_base import __version__
from nw_base.errors import NwEvalError
from nw_base.words import Backend, Projection, UpAxis

if TYPE_CHECKING:
    from nw_splat.files.convert import WrittenSplat
    from nw_splat.gaussians import SplatFigures


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, and leave with its exit code."""
    given = _parser().parse_args(arguments)
    try:
        print({"info": _info, "convert": _convert, "render": _render}[given.verb](given))
    except NwEvalError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(error.exit_code) from None
    raise SystemExit(0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nw-splat", description="Look into files of Gaussians, convert them, and draw them."
    )
    parser.add_argument("--version", action="version", version=f"nw-splat {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    info = verbs.add_parser("info", help="show the contents of a file")
    convert = verbs.add_parser("convert", help="write Gaussians as another file")
    render = verbs.add_parser("render", help="draw a still (.png), or a turn (.gif, .mp4)")
    for verb in (info, convert, render):
        verb.add_argument("source", metavar="FILE", help="PLY, SPZ, SOG, .splat or gsplat .pt")
    convert.add_argument("--out", required=True, type=Path, help=".ply, .pt, .spz or .splat")
    add = render.add_argument
    add("--out", default=Path("splat.png"), type=Path, help=".png, .gif or .mp4")
    add("--width", default=640, type=int, help="pixels across (default: 640)")
    add("--height", default=360, type=int, help="pixels down (default: 360)")
    add("--up", default="-y", choices=get_args(UpAxis), help="upward axis (default: -y)")
    for name, words in (
        ("eye", "where the camera stands, and a turn looks round from"),
        ("target", "what a still looks at; needs --eye"),
    ):
        add(f"--{name}", nargs=3, type=float, metavar=("X", "Y", "Z"), help=words)
    add("--frames", default=48, type=int, help="of a turn (default: 48)")
    add("--render", default="cpu", choices=get_args(Backend), help="the renderer")
    add("--projection", default="ray", choices=get_args(Projection), help="or as gsplat draws")
    return parser


def _info(given: argparse.Namespace) -> str:
    from nw_splat.files import read_splat
    from nw_splat.gaussians import describe

    return splat_page(describe(read_splat(Path(given.source))))


def _convert(given: argparse.Namespace) -> str:
    from nw_splat.files import read_splat
    from nw_splat.files.convert import write_new

    return written_line(write_new(given.out, read_splat(Path(given.source))))


def _render(given: argparse.Namespace) -> str:
    from nw_splat import portrait
    from nw_splat.files import read_splat

    eye = tuple(given.eye) if given.eye else None
    target = tuple(given.target) if given.target else None
    portrait.check(given.out, eye, target)
    subject = portrait.Subject(gaussians=read_splat(Path(given.source)), up=given.up)
    subject.draw(
        given.out,
        size=(given.width, given.height),
        eye=eye,
        target=target,
        frames=given.frames,
        backend=given.render,
        projection=given.projection,
    )
    return str(given.out)


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
    """Return a line with the written file and its size; notes on the source come first."""
    left = f", {splat.left_out:,} that cannot be drawn left out" if splat.left_out else ""
    size = f"{splat.bytes / 2**20:.1f} MiB"
    notes = [f"note: {note}" for note in splat.notes]
    return "\n".join([*notes, f"{splat.file}: {splat.gaussians:,} Gaussians, {size}{left}"])


def _box(corners: tuple[tuple[float, ...], tuple[float, ...]]) -> str:
    low, high = corners
    return "  ".join(
        f"{axis} {a:.3f} to {b:.3f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
