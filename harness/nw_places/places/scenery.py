"""Houses from outside, and things that stand about outdoors."""

from __future__ import annotations

import math
from collections.abc import Iterable

from nw_places.places.builder import ALL_FACES, SceneBuilder, about
from nw_places.places.parts import Decal, Pair

# Offsets of a crown's clouds from its middle, in parts of its radius, and their own radii.
_CLOUDS = (
    (0.0, 0.0, 0.15, 0.72),
    (0.52, 0.1, -0.12, 0.55),
    (-0.34, 0.46, -0.05, 0.56),
    (-0.30, -0.48, 0.0, 0.54),
    (0.22, -0.30, 0.42, 0.46),
)


def tree(
    builder: SceneBuilder,
    x: float,
    y: float,
    *,
    height: float = 5.5,
    radius: float = 1.8,
    trunk: float = 0.15,
    leaves: str = "leaves/lime",
    turn: float = 0.0,
    far: bool = False,
) -> None:
    """Plant a tree: a trunk that one can bump into, and a crown of clouds of leaves.

    Args:
        builder: of the scene that it stands in.
        x: metres.
        y: metres.
        height: metres from the ground to its top.
        radius: of the whole crown, metres.
        trunk: radius of the trunk at its foot, metres.
        leaves: material.
        turn: radians by which its crown is turned, so that trees differ.
        far: draws the crown as one cloud.
    """
    clear = height - 1.55 * radius
    half = trunk * 0.68
    if not far:
        builder.box(about(x, half), about(y, half), (0.0, clear), "bark/brown", faces=())
    lean = (0.05 * radius * math.cos(3 * turn), 0.05 * radius * math.sin(3 * turn))
    builder.prism(
        (x, y),
        (0.0, clear + 0.6 * radius),
        (trunk, trunk * 0.6),
        "bark/brown",
        sides=6 if far else 10,
        lean=lean,
    )
    middle = height - radius * 0.85
    clouds = ((0.0, 0.0, 0.0, 0.9),) if far else _CLOUDS
    for cloud_x, cloud_y, cloud_z, size in clouds:
        cosine, sine = math.cos(turn), math.sin(turn)
        builder.crown(
            (
                x + lean[0] + radius * (cosine * cloud_x - sine * cloud_y),
                y + lean[1] + radius * (sine * cloud_x + cosine * cloud_y),
                middle + 0.9 * radius * cloud_z,
            ),
            (radius * size, radius * size, radius * size * 0.82),
            leaves,
        )


def hedge(
    builder: SceneBuilder, x: Pair, y: Pair, height: float, leaves: str = "leaves/hedge"
) -> None:
    """Plant a clipped hedge between two corners; physics touches a box within it."""
    builder.box(
        (x[0] + 0.1, x[1] - 0.1), (y[0] + 0.1, y[1] - 0.1), (0.0, height - 0.1), "soil", faces=()
    )
    long_x = x[1] - x[0] >= y[1] - y[0]
    length = (x[1] - x[0]) if long_x else (y[1] - y[0])
    across = (y[1] - y[0]) if long_x else (x[1] - x[0])
    count = max(1, round(length / (0.8 * across)))
    for index in range(count):
        along = (index + 0.5) * length / count
        center = (x[0] + along, (y[0] + y[1]) / 2) if long_x else ((x[0] + x[1]) / 2, y[0] + along)
        reach = 0.62 * length / count
        builder.crown(
            (*center, height * 0.5),
            (reach if long_x else across * 0.55, across * 0.55 if long_x else reach, height * 0.56),
            leaves,
            kind="clutter",
        )


def bush(
    builder: SceneBuilder, x: float, y: float, radius: float, leaves: str = "leaves/hedge"
) -> None:
    """Plant a round bush."""
    builder.box(
        about(x, radius * 0.55), about(y, radius * 0.55), (0.0, radius * 0.9), "soil", faces=()
    )
    builder.crown((x, y, radius * 0.65), (radius, radius, radius * 0.75), leaves, kind="clutter")
    builder.crown(
        (x + 0.5 * radius, y - 0.45 * radius, radius * 0.4),
        (radius * 0.6, radius * 0.6, radius * 0.5),
        leaves,
        kind="clutter",
    )


def bench(
    builder: SceneBuilder, x: float, y: float, *, facing: float, wood: str = "planks/teak"
) -> None:
    """Put a park bench along x; `facing` is +1 or -1, where along y its sitters look."""
    length = 1.7
    for slat in range(3):
        low = y + facing * (-0.20 + 0.145 * slat)
        builder.box(
            about(x, length / 2),
            (min(low, low + facing * 0.12), max(low, low + facing * 0.12)),
            (0.43, 0.46),
            wood,
            faces=ALL_FACES,
            fine=0.8,
            solid=slat == 1,
        )
    for slat in range(2):
        back = y - facing * 0.24
        low = 0.56 + 0.16 * slat
        builder.box(
            about(x, length / 2), about(back, 0.016), (low, low + 0.12), wood, fine=0.8, solid=False
        )
    for end in (-0.62, 0.62):
        for leg in (-0.17, 0.17):
            builder.box(
                about(x + end, 0.025), about(y + leg, 0.025), (0.0, 0.43), "metal/dark", fine=0.8
            )
        builder.box(
            about(x + end, 0.03),
            about(y - facing * 0.24, 0.03),
            (0.40, 0.84),
            "metal/dark",
            fine=0.8,
            solid=False,
        )


def lamp_post(
    builder: SceneBuilder, x: float, y: float, *, height: float = 3.6, lit: bool = False
) -> None:
    """Stand a lantern on a pole."""
    builder.box(about(x, 0.04), about(y, 0.04), (0.0, height), "metal/dark", faces=())
    builder.prism((x, y), (0.0, 0.5), (0.085, 0.075), "metal/dark", sides=8)
    builder.prism((x, y), (0.5, height), (0.05, 0.045), "metal/dark", sides=8)
    glass = "glow/warm" if lit else "milk_glass"
    builder.prism((x, y), (height, height + 0.42), (0.13, 0.19), glass, sides=6, kind="overhead")
    builder.prism(
        (x, y), (height + 0.42, height + 0.5), (0.24, 0.06), "metal/dark", sides=6, kind="overhead"
    )
    if lit:
        builder.lamp(
            (x - 0.2, y - 0.2, height - 0.02), (0.0, 0.4, 0.0), (0.4, 0.0, 0.0), (60.0, 36.0, 15.0)
        )


def wall_lamp(builder: SceneBuilder, x: float, y: float, side: int, *, height: float = 2.5) -> None:
    """Hang a burning lantern on a wall at `y` that stands to the left (+1) or right (-1)."""
    out = y - side * 0.12
    builder.box(
        about(x, 0.09),
        about(out, 0.09),
        (height, height + 0.26),
        "glow/warm",
        kind="overhead",
        solid=False,
        faces=("-x", "+x", "-y", "+y", "-z"),
    )
    builder.lamp(
        (x - 0.12, out - 0.12, height - 0.02), (0.0, 0.24, 0.0), (0.24, 0.0, 0.0),
        (70.0, 44.0, 20.0),
    )  # fmt: skip


def litter_bin(builder: SceneBuilder, x: float, y: float, material: str = "metal/green") -> None:
    """Stand a litter bin."""
    half = 0.15
    builder.box(about(x, half), about(y, half), (0.0, 0.8), material, faces=())
    builder.prism((x, y), (0.05, 0.8), (0.2, 0.21), material, sides=10, cap="metal/black")


def dumpster(builder: SceneBuilder, x: Pair, y: Pair, material: str = "metal/green") -> None:
    """Park a rubbish container with a dark lid."""
    builder.box(x, y, (0.12, 1.15), material, fine=0.9)
    builder.box(
        (x[0] - 0.03, x[1] + 0.03), (y[0] - 0.03, y[1] + 0.03), (1.15, 1.24), "plastic/black"
    )
    for wheel_x in (x[0] + 0.15, x[1] - 0.15):
        builder.box(
            about(wheel_x, 0.07),
            (y[0] + 0.05, y[1] - 0.05),
            (0.0, 0.12),
            "rubber/black",
            solid=False,
        )


def planter(builder: SceneBuilder, x: Pair, y: Pair, *, height: float = 0.5, stone: str) -> None:
    """Put down a stone trough with bushes."""
    builder.box(x, y, (0.0, height), stone, top="soil")
    length, across = x[1] - x[0], y[1] - y[0]
    count = max(1, round(max(length, across) / 0.7))
    for index in range(count):
        share = (index + 0.5) / count
        center = (
            (x[0] + share * length, (y[0] + y[1]) / 2)
            if length >= across
            else ((x[0] + x[1]) / 2, y[0] + share * across)
        )
        reach = 0.5 * min(length, across)
        builder.crown(
            (*center, height + 0.55 * reach), (reach, reach, reach * 0.75), "leaves/hedge"
        )


def car(
    builder: SceneBuilder,
    x: float,
    y: float,
    paint: str,
    *,
    along_y: bool = True,
    nose: float = 1.0,
) -> None:
    """Park a car with its middle at a point; physics touches one box.

    Args:
        builder: of the scene that it stands in.
        x: metres.
        y: metres.
        paint: material.
        along_y: whether it stands across the course's direction.
        nose: +1 or -1, where along its axis the car looks.
    """
    length, width = 4.2, 1.74
    half = (width / 2, length / 2) if along_y else (length / 2, width / 2)
    builder.box(about(x, half[0]), about(y, half[1]), (0.25, 0.82), paint, faces=())

    def point(along: float, across: float, z: float) -> tuple[float, float, float]:
        if along_y:
            return (x - across * nose, y + along * nose, z)
        return (x + along * nose, y + across * nose, z)

    def sheet(
        corner: tuple[float, float, float],
        u_end: tuple[float, float, float],
        v_end: tuple[float, float, float],
        material: str,
        decals: tuple[Decal, ...] = (),
    ) -> None:
        start = point(*corner)
        one, two = point(*u_end), point(*v_end)
        builder.quad(
            start,
            (one[0] - start[0], one[1] - start[1], one[2] - start[2]),
            (two[0] - start[0], two[1] - start[1], two[2] - start[2]),
            material,
            kind="clutter",
            decals=decals,
        )

    f, b, w = length / 2, -length / 2, width / 2
    # Flanks, with wheel arches drawn on them.
    arches = tuple(
        Decal((at - 0.36, 0.0, at + 0.36, 0.46), paint.replace("car", "wheel"), 0.4)
        for at in (0.82, length - 0.86)
    )
    sheet((b, -w, 0.18), (f, -w, 0.18), (b, -w, 0.88), paint, arches)
    sheet((f, w, 0.18), (b, w, 0.18), (f, w, 0.88), paint, arches)
    # Front with lights and grille, back with lights.
    front = (
        Decal((0.06, 0.40, 0.40, 0.58), "headlight", 0.5),
        Decal((width - 0.40, 0.40, width - 0.06, 0.58), "headlight", 0.5),
        Decal((0.45, 0.16, width - 0.45, 0.44), "grille", 0.5),
    )
    rear = (
        Decal((0.05, 0.42, 0.36, 0.62), "taillight", 0.5),
        Decal((width - 0.36, 0.42, width - 0.05, 0.62), "taillight", 0.5),
        Decal((width / 2 - 0.26, 0.22, width / 2 + 0.26, 0.34), "plate", 0.4),
    )
    sheet((f, -w, 0.18), (f, w, 0.18), (f, -w, 0.76), paint, front)
    sheet((b, w, 0.18), (b, -w, 0.18), (b, w, 0.88), paint, rear)
    # Bonnet, windscreen, roof, rear window, boot.
    n = w - 0.20
    sheet((f, -w, 0.74), (f, w, 0.74), (0.95, -w, 0.90), paint)
    sheet((0.95, -n, 0.90), (0.95, n, 0.90), (0.25, -n, 1.40), "glass/dark")
    sheet((0.25, -n, 1.40), (0.25, n, 1.40), (-1.25, -n, 1.42), paint)
    sheet((-1.25, -n, 1.42), (-1.25, n, 1.42), (-1.90, -n, 0.92), "glass/dark")
    sheet((-1.90, -w, 0.92), (-1.90, w, 0.92), (b, -w, 0.88), paint)
    # Side windows lean in and grow shorter upwards: strips, since patches are parallelograms.
    strips = 5
    for strip in range(strips):
        low, high = strip / strips, (strip + 1) / strips
        back, front_end = -1.86 + 0.58 * low, 0.90 - 0.62 * low
        z0, z1 = 0.88 + 0.53 * low, 0.88 + 0.53 * high
        in0, in1 = w - 0.02 - 0.18 * low, w - 0.02 - 0.18 * high
        material = paint if strip == strips - 1 else "glass/dark"
        sheet((back, -in0, z0), (front_end, -in0, z0), (back, -in1, z1), material)
        sheet((front_end, in0, z0), (back, in0, z0), (front_end, in1, z1), material)


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
        decals.append(Decal((0.0, 0.0, length, 0.4), plinth, 0.8))
    columns = max(1, int(length / pitch))
    margin = (length - columns * pitch) / 2
    skipped = set(skip)
    levels = int((height - 0.4) / storey)
    if trim is not None:
        for level in range(1, levels + 1):
            foot = min(level * storey, height - 0.25)
            decals.append(Decal((0.0, foot - 0.12, length, foot), trim, 0.9))
    for level in range(levels):
        for column in range(columns):
            if level == 0 and column in skipped:
                continue
            u0 = margin + column * pitch + (pitch - size[0]) / 2
            v0 = level * storey + sill
            if trim is not None:
                top = v0 + size[1]
                decals.append(Decal((u0 - 0.1, top, u0 + size[0] + 0.1, top + 0.2), trim, 0.8))
                decals.append(Decal((u0 - 0.1, v0 - 0.1, u0 + size[0] + 0.1, v0), trim, 0.8))
            decals.append(Decal((u0, v0, u0 + size[0], v0 + size[1]), windows, 0.5))
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
