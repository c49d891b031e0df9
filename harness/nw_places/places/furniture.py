"""Rooms: their floor, walls and ceiling, and the things that stand about in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from nw_places.places.builder import ALL_FACES, SIDES, SceneBuilder, about
from nw_places.places.parts import Decal, Pair
from nw_scenes.scene import Vector

_THICKNESS = 0.12


def room_shell(
    builder: SceneBuilder,
    x: Pair,
    y: Pair,
    height: float,
    *,
    floor: str,
    walls: str,
    far: str | None = None,
    ceiling: str,
    skirting: str | None = "skirting/white",
    floor_decals: Iterable[Decal] = (),
    decals: Mapping[str, Iterable[Decal]],
) -> None:
    """Build floor, ceiling and four walls round a rectangle.

    Walls are called `left` (+y), `right` (-y), `far` (+x, of a material of its own where given)
    and `back` (-x). A wall's decals are
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
        strip = () if skirting is None else (Decal((0.0, 0.0, length, 0.09), skirting, 0.8),)
        builder.box(
            across,
            along,
            (0.0, height),
            (far or walls) if name == "far" else walls,
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


def table(
    builder: SceneBuilder, x: Pair, y: Pair, *, top: str = "veneer/beech", height: float = 0.74
) -> None:
    """Put a table with four legs between two corners."""
    builder.box(x, y, (height - 0.035, height), top, faces=ALL_FACES)
    inset = 0.06
    for leg_x in (x[0] + inset, x[1] - inset):
        for leg_y in (y[0] + inset, y[1] - inset):
            builder.box(
                about(leg_x, 0.022),
                about(leg_y, 0.022),
                (0.0, height - 0.035),
                "metal/dark",
                faces=SIDES,
                fine=0.7,
            )


def chair(
    builder: SceneBuilder, x: float, y: float, *, facing: float, seat: str = "plastic/navy"
) -> None:
    """Put a chair at a point; `facing` is +1 or -1, where along y its sitter would look."""
    builder.box(about(x, 0.22), about(y, 0.21), (0.43, 0.46), seat, faces=ALL_FACES, fine=0.8)
    back = y - 0.21 * facing
    builder.box(about(x, 0.21), about(back, 0.015), (0.58, 0.86), seat, faces=ALL_FACES, fine=0.8)
    for leg_x in (x - 0.19, x + 0.19):
        for leg_y, top in ((back, 0.60), (back + 0.40 * facing, 0.43)):
            builder.box(
                about(leg_x, 0.013),
                about(leg_y, 0.013),
                (0.0, top),
                "metal/chrome",
                faces=SIDES,
                fine=0.7,
            )


def bookshelf(
    builder: SceneBuilder,
    x: Pair,
    y: Pair,
    *,
    face: str,
    height: float = 1.95,
    wood: str = "veneer/birch",
) -> None:
    """Stand a shelf full of books against a wall; `face` is the side that shows them."""
    length = (x[1] - x[0]) if face[1] == "y" else (y[1] - y[0])
    rows = max(1, round((height - 0.1) / 0.37))
    pitch = (height - 0.1) / rows
    books = [
        Decal(
            (0.025, 0.08 + row * pitch, length - 0.025, 0.08 + (row + 1) * pitch - 0.03),
            "books",
            0.45,
        )
        for row in range(rows)
    ]
    builder.box(x, y, (0.0, height), wood, decals={face: books}, fine=0.8)


def plant(
    builder: SceneBuilder, x: float, y: float, *, height: float = 1.1, pot: str = "clay"
) -> None:
    """Stand a leafy plant in a pot on the floor."""
    builder.box(about(x, 0.13), about(y, 0.13), (0.0, 0.30), pot, top="soil", fine=0.8)
    builder.prism((x, y), (0.30, height * 0.6), (0.02, 0.015), "bark/brown", sides=5)
    builder.crown((x, y, height * 0.68), (0.30, 0.30, height * 0.36), "leaves/house", fine=0.8)


def radiator(builder: SceneBuilder, x: Pair, y: Pair) -> None:
    """Hang a radiator along a wall."""
    builder.box(x, y, (0.14, 0.68), "radiator/white", fine=0.8)


def crate(
    builder: SceneBuilder, x: Pair, y: Pair, z: Pair, material: str = "planks/pallet"
) -> None:
    """Put down a wooden crate or a carton."""
    builder.box(x, y, z, material, fine=0.9)


def drum(builder: SceneBuilder, x: float, y: float, material: str) -> None:
    """Stand an oil drum on the floor; physics touches the box within it."""
    half = 0.205
    builder.box(about(x, half), about(y, half), (0.0, 0.88), material, faces=(), fine=1.0)
    builder.prism((x, y), (0.0, 0.88), (0.29, 0.29), material, sides=14, cap="metal/dark")
