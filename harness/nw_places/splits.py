"""Which built-in scenes are for training and which for evaluation: 70 to 30 of each task."""

from __future__ import annotations

from typing import Literal, get_args

Split = Literal["train", "eval"]
SPLITS: tuple[Split, ...] = get_args(Split)

# Five of the sixteen scenes of each task, chosen by hand: easy and hard ones, indoors and outdoors,
# by day and otherwise.
EVALUATION: tuple[str, ...] = (
    "gaps/three_16in_hall",
    "gaps/three_concrete_car_park",
    "gaps/three_decks_garden",
    "gaps/three_stone_cloister_dusk",
    "gaps/two_12in_carpet",
    "hurdles/one_high_stone_plaza",
    "hurdles/three_low",
    "hurdles/two_beams_yard_night",
    "hurdles/two_foam_office",
    "hurdles/two_logs_park",
    "ramps/aligned_boards_bricks",
    "ramps/offset_boards_office",
    "ramps/spread_boards_grass",
    "ramps/two_ramps_car_park_night",
    "ramps/two_ramps_warehouse",
    "stairs/curved_granite_plaza",
    "stairs/eight_open_wood_lobby",
    "stairs/seven_brick_courtyard",
    "stairs/seven_stone_alley_night",
    "stairs/varied_stone_cloister",
)


def split_of(name: str) -> Split | None:
    """Return a built-in scene's split by its name; None for scenes that belong to no task's list.

    The empty `flat/` place, the wide `open/` ones and rungs of ladders (`NAME@0.3`) are in neither.
    A variant (`NAME~2`) is of its scene's split.
    """
    if "@" in name:
        return None
    if name.partition("~")[0] in EVALUATION:
        return "eval"
    return None if name.startswith(("flat/", "open/")) else "train"
