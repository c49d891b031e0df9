"""Walls with windows and doors: of rooms from inside, of houses from outside."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from nw_eval.built_in.places.builder import SceneBuilder
from nw_eval.built_in.places.parts import Decal, Pair
from nw_eval.scenes.scene import Vector

_THICKNESS = 0.12


def room_shell(
    builder: SceneBuilder,
    x: Pair,
    y: Pair,
    height: float,
    *,
    floor: str,
    walls: dict[str, str],
    ceiling: str,
    skirting: str | None = "skirting/white",
    floor_decals: Iterable[Decal] = (),
    decals: Mapping[str, Iterable[Decal]],
) -> None:
    """Build floor, ceiling and four walls round a rectangle.

    Walls are called `left` (+y), `right` (-y), `far` (+x) and `back` (-x). A wall's decals are
    measured from its left end as somebody in the room sees it, and from the floor; the floor's
    are in world coordinates.
    """
    builder.ground(floor, x, y, decals=floor_decals)
    builder.quad(
        (x[0], y[0], height),
        (0.0, y[1] - y[0], 0.0),
        (x[1] - x[0], 0.0, 0.0),
        ceiling,
        kind="overhead",
        fine=1.5,
        decals=decals.get("ceiling", ()),
    )
    sides: dict[str, tuple[Pair, Pair, str, float]] = {
        "left": (x, (y[1], y[1] + _THICKNESS), "-y", x[1] - x[0]),
        "right": (x, (y[0] - _THICKNESS, y[0]), "+y", x[1] - x[0]),
        "far": ((x[1], x[1] + _THICKNESS), y, "-x", y[1] - y[0]),
        "back": ((x[0] - _THICKNESS, x[0]), y, "+x", y[1] - y[0]),
    }
    for name, (across, along, face, length) in sides.items():
        strip = (
            ()
            if skirting is None
            else (Decal(rect=(0.0, 0.0, length, 0.09), material=skirting, fine=0.8),)
        )
        builder.box(
            across,
            along,
            (0.0, height),
            walls[name],
            kind="structure",
            faces=(face,),
            decals={face: (*strip, *decals.get(name, ()))},
        )


def window_lamp(
    builder: SceneBuilder, corner: Vector, u: Vector, v: Vector, brightness: float = 0.75
) -> None:
    """Let daylight in through a window: `u` x `v` points into the room."""
    sky = builder.light.horizon
    builder.lamp(corner, u, v, (sky[0] * brightness, sky[1] * brightness, sky[2] * brightness))


def house(
    builder: SceneBuilder,
    x: Pair,
    y: Pair,
    height: float,
    walls: str,
    *,
    face: str,
    other_faces: Iterable[str] = (),
    windows: str = "house_window/white",
    pitch: float = 2.4,
    storey: float = 3.0,
    sill: float = 0.95,
    size: Pair = (1.1, 1.45),
    extra: Iterable[Decal] = (),
    skip: Iterable[int] = (),
    plinth: str | None = "concrete/grey",
    trim: str | None = "coping/grey",
    roof: str = "concrete/dark",
    fine: float = 1.0,
) -> None:
    """Build a house as one box whose `face` looks at the course, with a grid of windows.

    Args:
        builder: of the scene that it is part of.
        x: from and to.
        y: from and to.
        height: metres.
        walls: material.
        face: the face with windows, such as `-y`.
        other_faces: faces that are painted without windows.
        windows: material.
        roof: material.
        fine: multiplies the spacing of Gaussians.
        pitch: metres from window to window.
        storey: metres from floor to floor.
        sill: metres from a floor to its windows' sills.
        size: width and height of a window.
        plinth: material of its foot.
        trim: material of lintels, sills and the bands between storeys.
        extra: further decals of that face, such as doors, in its own coordinates.
        skip: columns without a window on the ground floor.
    """
    length = (x[1] - x[0]) if face[1] == "y" else (y[1] - y[0])
    decals: list[Decal] = []
    if plinth is not None:
        decals.append(Decal(rect=(0.0, 0.0, length, 0.4), material=plinth, fine=0.8))
    columns = max(1, int(length / pitch))
    margin = (length - columns * pitch) / 2
    skipped = set(skip)
    levels = int((height - 0.4) / storey)
    if trim is not None:
        for level in range(1, levels + 1):
            foot = min(level * storey, height - 0.25)
            decals.append(Decal(rect=(0.0, foot - 0.12, length, foot), material=trim, fine=0.9))
    for level in range(levels):
        for column in range(columns):
            if level == 0 and column in skipped:
                continue
            u0 = margin + column * pitch + (pitch - size[0]) / 2
            v0 = level * storey + sill
            if trim is not None:
                top = v0 + size[1]
                decals.append(
                    Decal(
                        rect=(u0 - 0.1, top, u0 + size[0] + 0.1, top + 0.2), material=trim, fine=0.8
                    )
                )
                decals.append(
                    Decal(
                        rect=(u0 - 0.1, v0 - 0.1, u0 + size[0] + 0.1, v0), material=trim, fine=0.8
                    )
                )
            decals.append(
                Decal(rect=(u0, v0, u0 + size[0], v0 + size[1]), material=windows, fine=0.5)
            )
    decals += extra
    builder.box(
        x,
        y,
        (0.0, height),
        walls,
        top=roof,
        kind="structure",
        faces=(face, *other_faces),
        fine=fine,
        decals={face: decals},
    )
