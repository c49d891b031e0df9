"""A long corridor: shining floor, doors on both sides, light panels, a window at its end."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell, window_lamp


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """A corridor of a school or a laboratory.

    Attributes:
        floor, walls: materials.
        dado: material of the walls' lower part.
        width, height: metres.
    """

    floor: str = "linoleum/sea"
    walls: str = "plaster/white"
    dado: str = "plaster/sage"
    width: float = 2.6
    height: float = 2.6
    indoor: bool = True

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the corridor."""
        x = (-3.0, length + 7.0)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        doors = [span * share for share in (0.1, 0.34, 0.58, 0.82)]
        middle = self.width / 2
        panels = [x[0] + 1.2 + 2.4 * index for index in range(int((span - 1.0) / 2.4))]

        def side(shift: float) -> list[Decal]:
            strip = Decal(rect=(0.0, 0.09, span, 1.05), material=self.dado, fine=1.0)
            rail = Decal(rect=(0.0, 1.05, span, 1.10), material="skirting/oak", fine=0.8)
            signs = [
                Decal(rect=(u + shift + 1.1, 1.45, u + shift + 1.28, 1.57), material="sign")
                for u in doors
            ]
            boards = [
                Decal(
                    rect=(u + shift + 1.7, 1.25, u + shift + 2.6, 1.95),
                    material=("pinboard", "poster/teal")[index % 2],
                    fine=0.55,
                )
                for index, u in enumerate(doors[:-1])
            ]
            leaves = [
                Decal(
                    rect=(u + shift, 0.0, u + shift + 0.98, 2.08),
                    material=("door/blue", "door/oak")[index % 2],
                    fine=0.55,
                )
                for index, u in enumerate(doors)
            ]
            return [strip, rail, *boards, *signs, *leaves]

        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls=dict.fromkeys(("left", "right", "far", "back"), self.walls),
            ceiling="ceiling_tiles",
            skirting="skirting/grey",
            decals={
                "left": side(0.0),
                "right": side(0.5),
                "far": [
                    Decal(
                        rect=(middle - 0.75, 0.0, middle + 0.75, 2.15),
                        material="glass_doors",
                        fine=0.5,
                    ),
                    Decal(rect=(middle - 0.2, 2.25, middle + 0.2, 2.42), material="exit", fine=0.5),
                ],
                "back": [
                    Decal(rect=(middle - 0.8, 0.0, middle + 0.8, 2.15), material="doors", fine=0.6)
                ],
                "ceiling": [
                    Decal(
                        rect=(middle - 0.15, at - 0.6 - x[0], middle + 0.15, at + 0.6 - x[0]),
                        material="lamp",
                        fine=0.5,
                    )
                    for at in panels
                ],
            },
        )
        for at in panels:
            builder.lamp(
                (at - 0.6, -0.15, self.height - 0.02), (0.0, 0.3, 0.0), (1.2, 0.0, 0.0),
                (5.2, 5.1, 4.7),
            )  # fmt: skip
        window_lamp(builder, (x[1] - 0.02, 0.75, 0.05), (0.0, -1.5, 0.0), (0.0, 0.0, 2.1))
        self._furnish(builder, length, y)

    def _furnish(self, builder: PlaceBuilder, length: float, y: tuple[float, float]) -> None:
        lockers = length + 1.2
        for index in range(4):
            start = lockers + 0.42 * index
            builder.box(
                (start, start + 0.40), (y[0], y[0] + 0.34), (0.0, 1.75), "locker/blue", fine=0.7
            )
        builder.box((-0.2, 0.25), (y[1] - 0.10, y[1]), (0.85, 1.45), "extinguisher", solid=False)
        furniture.plant(builder, length + 3.6, y[1] - 0.32, height=1.3)
        furniture.chair(builder, length + 1.6, y[1] - 0.35, facing=-1.0, seat="plastic/orange")
        furniture.chair(builder, length + 2.2, y[1] - 0.35, facing=-1.0)
