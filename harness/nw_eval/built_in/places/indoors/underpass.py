"""An underpass: concrete and tiles, murals, lamps in the ceiling, daylight at its end."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell, window_lamp


@dataclass(frozen=True, kw_only=True)
class Underpass:
    """A way for people under a road.

    Attributes:
        floor, walls: materials.
        dado: material of the walls' lower part.
        mural: materials of the paintings on the left and the right.
        width, height: metres.
    """

    floor: str = "slabs/grey"
    walls: str = "concrete/light"
    dado: str = "block_wall/white"
    mural: tuple[str, str] = ("mural/teal", "mural/pink")
    width: float = 4.2
    height: float = 2.9
    indoor: bool = True

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the underpass."""
        x = (-4.0, length + 8.0)
        y = (-self.width / 2, self.width / 2)
        span, middle = x[1] - x[0], self.width / 2
        lamps = [x[0] + 1.6 + 2.8 * index for index in range(int((span - 1.2) / 2.8))]

        def side(paintings: tuple[tuple[float, float], ...], mural: str) -> list[Decal]:
            return [
                Decal(rect=(0.0, 0.0, span, 1.0), material=self.dado, fine=1.0),
                *(
                    Decal(rect=(u, 0.35, u + w, 2.2), material=mural, fine=0.6)
                    for u, w in paintings
                ),
            ]

        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            floor_decals=(
                Decal(rect=(x[0], y[0], x[1], y[0] + 0.25), material="gutter/grey"),
                Decal(rect=(x[0], y[1] - 0.25, x[1], y[1]), material="gutter/grey"),
                Decal(rect=(length + 0.7, -0.25, length + 1.2, 0.25), material="drain", fine=0.5),
            ),
            walls=dict.fromkeys(("left", "right", "far", "back"), self.walls),
            ceiling="concrete/grey",
            skirting=None,
            decals={
                "left": side(((3.0, 3.4), (9.5, 2.8)), self.mural[0]),
                "right": side(((5.2, 3.0), (11.5, 3.2)), self.mural[1]),
                "far": [
                    Decal(
                        rect=(0.25, 0.0, self.width - 0.25, self.height - 0.35),
                        material="portal",
                        fine=0.6,
                    )
                ],
                "back": [
                    Decal(rect=(middle - 1.2, 0.0, middle + 1.2, 2.3), material="roller_door")
                ],
                "ceiling": [
                    Decal(
                        rect=(edge - 0.12, at - 0.7 - x[0], edge + 0.12, at + 0.7 - x[0]),
                        material="lamp",
                        fine=0.5,
                    )
                    for at in lamps
                    for edge in (0.5, self.width - 0.5)
                ],
            },
        )
        for at in lamps:
            for edge in (y[0] + 0.5, y[1] - 0.5):
                builder.lamp(
                    (at - 0.7, edge - 0.12, self.height - 0.02), (0.0, 0.24, 0.0), (1.4, 0.0, 0.0),
                    (6.0, 5.8, 5.2),
                )  # fmt: skip
        window_lamp(
            builder, (x[1] - 0.02, middle - 0.25, 0.05), (0.0, -self.width + 0.5, 0.0),
            (0.0, 0.0, self.height - 0.4),
        )  # fmt: skip
        for at in (1.8, length + 2.6):
            builder.box(
                (at, at + 1.6), (y[1] - 0.55, y[1] - 0.12), (0.0, 0.45), "concrete/light", fine=0.9
            )
        builder.prism((length + 3.4, y[0] + 0.35), (0.0, 0.85), (0.2, 0.21), "metal/green",
                    sides=10, cap="metal/black")  # fmt: skip
