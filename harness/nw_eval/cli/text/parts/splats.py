"""Files of Gaussians as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api import WrittenSplat
    from nw_eval.splat.gaussians import SplatFigures

_BAR = 40
"""Characters of the longest bar of the histogram."""


def splat_page(figures: SplatFigures) -> str:
    """Return all figures of a set of Gaussians, the histogram of opacities as bars."""
    most = max(*figures.opacity_histogram, 1)
    seen, broken = f"{figures.visible:,} visible", f"{figures.not_finite:,} not finite"
    lines = [
        f"Gaussians  {figures.count:,} ({seen}, {broken})",
        f"harmonics  degree {figures.sh_degree}",
        f"drawn      {figures.rasterize_mode or 'antialiased (the file does not say)'}",
        f"bounds     {_box(figures.bounds)}",
        f"bulk (98%) {_box(figures.bulk)}",
        "size       1% {:.4g}, median {:.4g}, 99% {:.4g}".format(*figures.scale_percentiles),
        "opacity",
    ]
    for i, number in enumerate(figures.opacity_histogram):
        bar = "#" * round(_BAR * number / most)
        lines.append(f"  {i / 10:.1f}-{(i + 1) / 10:.1f} {number:>10,} {bar}".rstrip())
    return "\n".join(lines)


def written_line(splat: WrittenSplat) -> str:
    """Return what was written, and how large it is."""
    return f"{splat.file}: {splat.gaussians:,} Gaussians, {splat.bytes / 2**20:.1f} MiB"


def _box(corners: tuple[tuple[float, ...], tuple[float, ...]]) -> str:
    low, high = corners
    return "  ".join(
        f"{axis} {a:.3f} to {b:.3f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
