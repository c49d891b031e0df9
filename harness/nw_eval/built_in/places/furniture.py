"""Things that stand about in rooms."""

from __future__ import annotations

from nw_eval.built_in.places.builder import SceneBuilder
from nw_eval.built_in.places.parts import Decal, Pair


def table(
    builder: SceneBuilder, x: Pair, y: Pair, *, top: str = "veneer/beech", height: float = 0.74
) -> None:
    """Put a table with four legs between two corners."""
    builder.box(x, y, (height - 0.035, height), top, faces=("-x", "+x", "-y", "+y", "+z", "-z"))
    inset = 0.06
    for leg_x in (x[0] + inset, x[1] - inset):
        for leg_y in (y[0] + inset, y[1] - inset):
            builder.box(
                (leg_x - 0.022, leg_x + 0.022),
                (leg_y - 0.022, leg_y + 0.022),
                (0.0, height - 0.035),
                "metal/dark",
                faces=("-x", "+x", "-y", "+y"),
                fine=0.7,
            )


def chair(
    builder: SceneBuilder, x: float, y: float, *, facing: float, seat: str = "plastic/navy"
) -> None:
    """Put a chair at a point; `facing` is +1 or -1, where along y its sitter would look."""
    builder.box(
        (x - 0.22, x + 0.22),
        (y - 0.21, y + 0.21),
        (0.43, 0.46),
        seat,
        faces=("-x", "+x", "-y", "+y", "+z", "-z"),
        fine=0.8,
    )
    back = y - 0.21 * facing
    builder.box(
        (x - 0.21, x + 0.21),
        (back - 0.015, back + 0.015),
        (0.58, 0.86),
        seat,
        faces=("-x", "+x", "-y", "+y", "+z", "-z"),
        fine=0.8,
    )
    for leg_x in (x - 0.19, x + 0.19):
        for leg_y, top in ((back, 0.60), (back + 0.40 * facing, 0.43)):
            builder.box(
                (leg_x - 0.013, leg_x + 0.013),
                (leg_y - 0.013, leg_y + 0.013),
                (0.0, top),
                "metal/chrome",
                faces=("-x", "+x", "-y", "+y"),
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
            rect=(0.025, 0.08 + row * pitch, length - 0.025, 0.08 + (row + 1) * pitch - 0.03),
            material="books",
            fine=0.45,
        )
        for row in range(rows)
    ]
    builder.box(x, y, (0.0, height), wood, decals={face: books}, fine=0.8)


def plant(
    builder: SceneBuilder, x: float, y: float, *, height: float = 1.1, pot: str = "clay"
) -> None:
    """Stand a leafy plant in a pot on the floor."""
    builder.box((x - 0.13, x + 0.13), (y - 0.13, y + 0.13), (0.0, 0.30), pot, top="soil", fine=0.8)
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
    builder.box(
        (x - half, x + half), (y - half, y + half), (0.0, 0.88), material, faces=(), fine=1.0
    )
    builder.prism((x, y), (0.0, 0.88), (0.29, 0.29), material, sides=14, cap="metal/dark")
