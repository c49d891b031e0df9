"""Inclined boards as boxes: told by where their upper surface is."""

from __future__ import annotations

import math

from nw_eval.built_in.places.builder import ALL_FACES, PlaceBuilder
from nw_eval.built_in.places.parts import Decal, Pair

THICKNESS = 0.04
"""Of a board, metres."""

# Of the strips that keep shoes from slipping: from one to the next, width, to the sides; metres.
_TREAD_EVERY, _TREAD, _TREAD_MARGIN = 0.24, 0.06, 0.05


def pitched_board(
    builder: PlaceBuilder,
    x: Pair,
    z: Pair,
    y: Pair,
    material: str,
    *,
    treads: str | None = None,
    texture: Pair = (0.0, 0.0),
) -> None:
    """Lay a board whose upper surface runs from one height to another along the trail.

    Args:
        builder: of the place that it is part of.
        x: where its upper surface starts and ends, metres.
        z: the heights there.
        y: from and to.
        material: of all its faces.
        treads: material of strips across it, which show that it slants; None for none.
        texture: so that equal boards differ.
    """
    run, rise = x[1] - x[0], z[1] - z[0]
    length, slope = math.hypot(run, rise), math.atan2(rise, run)
    half = THICKNESS / 2
    # The middle lies half a thickness below the middle of the upper surface, across the slope.
    middle_x = (x[0] + x[1]) / 2 + half * math.sin(slope)
    middle_z = (z[0] + z[1]) / 2 - half * math.cos(slope)
    builder.box(
        (middle_x - length / 2, middle_x + length / 2),
        y,
        (middle_z - half, middle_z + half),
        material,
        pitch=-slope,
        kind="obstacle",
        faces=ALL_FACES,
        fine=0.7,
        decals=None if treads is None else {"+z": _treads(length, y[1] - y[0], treads)},
        texture=texture,
    )


def _treads(length: float, width: float, material: str) -> list[Decal]:
    """Return strips across a board, as far from its lower as from its upper end."""
    count = int((length - _TREAD) / _TREAD_EVERY)
    first = (length - (count - 1) * _TREAD_EVERY - _TREAD) / 2
    return [
        Decal(
            rect=(
                first + number * _TREAD_EVERY,
                _TREAD_MARGIN,
                first + number * _TREAD_EVERY + _TREAD,
                width - _TREAD_MARGIN,
            ),
            material=material,
        )
        for number in range(count)
    ]


def rolled_board(
    builder: PlaceBuilder,
    x: Pair,
    y: float,
    z: float,
    width: float,
    roll: float,
    material: str,
    *,
    texture: Pair = (0.0, 0.0),
) -> None:
    """Lay a board along the trail that leans to one side.

    Args:
        builder: of the place that it is part of.
        x: from and to.
        y: of the middle of its upper surface, metres.
        z: height of that middle, metres.
        width: across the trail, measured on the slope, metres.
        roll: radians; positive lifts its left side.
        material: of all its faces.
        texture: so that equal boards differ.
    """
    half = THICKNESS / 2
    middle_y = y + half * math.sin(roll)
    middle_z = z - half * math.cos(roll)
    builder.box(
        x,
        (middle_y - width / 2, middle_y + width / 2),
        (middle_z - half, middle_z + half),
        material,
        roll=roll,
        kind="obstacle",
        faces=ALL_FACES,
        fine=0.7,
        texture=texture,
    )
