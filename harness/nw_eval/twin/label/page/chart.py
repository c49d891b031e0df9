"""The height profile as an SVG drawing, heights three times as large as distances where it fits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nw_eval.twin.label.course.profile import HeightProfile

_WIDTH, _HEIGHT = 420, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 12, 16, 26
_POINTS = 600  # of the line: more than pixels


def profile_svg(profile: HeightProfile) -> str:
    """Return a drawing of the ground along a course, with its start and waypoints.

    Ground that is not there is left out of the line.
    """
    finite = profile.height[np.isfinite(profile.height)]
    if not len(finite):
        return _svg(f'<text x="{_LEFT}" y="{_HEIGHT // 2}">no ground along the trail yet</text>')
    length = max(float(profile.distance[-1]), 0.5)
    levels = np.concatenate([finite, profile.levels])
    middle = float(levels.max() + levels.min()) / 2
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    span = max(float(np.ptp(levels)) * 1.15, length / wide * high / 3, 0.1)

    def x_of(distance: float) -> float:
        return _LEFT + distance / length * wide

    def y_of(height: float) -> float:
        return _TOP + (0.5 - (height - middle) / span) * high

    parts: list[str] = []
    for height in _round_values(middle - span / 2, middle + span / 2):
        y = y_of(height)
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 4}" y="{y + 3:.1f}" text-anchor="end">{height:.2f}</text>'
        )
    parts += [
        f'<text x="{x_of(at):.1f}" y="{_HEIGHT - 12}" text-anchor="middle">{at:g}</text>'
        for at in _round_values(0.0, length)
    ]
    parts.append(
        f'<text x="{_WIDTH - _RIGHT}" y="{_HEIGHT - 1}" text-anchor="end">m from the start</text>'
    )
    parts += [
        f'<polyline points="{line}" fill="none" stroke="#345" stroke-width="1.5"/>'
        for line in _lines(profile, x_of, y_of)
    ]
    for i, (at, level) in enumerate(zip(profile.stops, profile.levels, strict=True)):
        x, y = x_of(float(at)), y_of(float(level))
        colour = "#e8590c" if i else "#2b8a3e"
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'
            f'<text x="{x:.1f}" y="{y - 7:.1f}" text-anchor="middle">{i or "start"}</text>'
        )
    return _svg("".join(parts))


def _svg(content: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" role="img" '
        'aria-label="height of the ground along the trail" font-size="10" '
        f'font-family="sans-serif" fill="#444" style="background:#fff">{content}</svg>'
    )


def _lines(
    profile: HeightProfile, x_of: Callable[[float], float], y_of: Callable[[float], float]
) -> list[str]:
    """Return the points of each stretch that has ground."""
    step = max(len(profile.distance) // _POINTS, 1)
    lines: list[list[str]] = [[]]
    for distance, height in zip(
        profile.distance[::step].tolist(), profile.height[::step].tolist(), strict=True
    ):
        if np.isfinite(height):
            lines[-1].append(f"{x_of(distance):.1f},{y_of(height):.1f}")
        elif lines[-1]:
            lines.append([])
    return [" ".join(line) for line in lines if line]


def _round_values(low: float, high: float) -> list[float]:
    """Return three to eight round numbers between two."""
    rough = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(min((1, 2, 5, 10), key=lambda part: abs(part * power - rough)) * power)
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [round(i * step, 6) for i in range(first, last + 1)]
