"""Every material by name, with its colours."""

from __future__ import annotations

from nw_places.bake import decor, floors, masonry, openings, timber
from nw_places.bake.spots import Coat, Colour, Material, Spots, linear

_CAR_COLOURS = {
    "silver": "#9aa0a6",
    "red": "#9c2a25",
    "blue": "#27477c",
    "white": "#d5d7d8",
    "black": "#1d1e22",
}
# Material, and its colours by name; the first is the one that goes without saying.
_TABLE: dict[str, tuple[Material, dict[str, str]]] = {
    # Underfoot.
    "carpet": (floors.carpet, {"blue": "#3c5c96", "grey": "#6d6e72", "red": "#7c2f33"}),
    "carpet_tiles": (floors.carpet_tiles, {"grey": "#74777c", "green": "#5d6f5c"}),
    "parquet": (floors.parquet, {"oak": "#b98a55", "walnut": "#7b5435"}),
    "tiles": (
        floors.floor_tiles,
        {"terracotta": "#a8664a", "white": "#cfccc4", "slate": "#62686d"},
    ),
    "linoleum": (floors.linoleum, {"sea": "#6f9390", "grey": "#8d9194", "sand": "#b8a88c"}),
    "concrete": (
        floors.concrete,
        {"grey": "#93918c", "worn": "#8c8a85", "light": "#b9b5ac", "dark": "#5d5c5a"},
    ),
    "tarmac": (floors.tarmac, {"dark": "#55565a", "old": "#6b6a68"}),
    "gravel": (floors.gravel, {"sand": "#b3a183", "grey": "#918d86"}),
    "soil": (floors.soil, {"brown": "#4d3d2f"}),
    "grass": (floors.grass, {"green": "#54692c", "dry": "#8a8548"}),
    "pavers": (floors.pavers, {"red": "#8f6555", "grey": "#87847f"}),
    "slabs": (floors.slabs, {"light": "#b7b2a8", "grey": "#96948f", "sand": "#b09c7c"}),
    "grating": (floors.grating, {"steel": "#8d9296"}),
    "granite": (floors.granite, {"black": "#3b3b40", "grey": "#85858a", "pink": "#9c7d74"}),
    "gutter": (floors.slabs, {"grey": "#85827c"}),
    "drain": (floors.drain, {"iron": "#4a4744"}),
    "stripe": (floors.stripe, {"white": "#d9d8d2", "yellow": "#d9a92c"}),
    "arrow": (floors.arrow, {"white": "#d9d8d2"}),
    "oil_stain": (floors.oil_stain, {"black": "#26252a"}),
    # Obstacles and furniture.
    "plywood": (timber.plywood, {"birch": "#d2ab74"}),
    "planks": (
        timber.planks,
        {"pine": "#c79a5f", "pallet": "#b08a5a", "teak": "#8a5a34", "worn": "#8f6f4b"},
    ),
    "timber": (timber.timber, {"brown": "#8b6844", "dark": "#54432f"}),
    "veneer": (timber.veneer, {"beech": "#c9a070", "birch": "#d8bd92"}),
    "foam": (timber.foam, {"red": "#b03a34", "blue": "#2c57a0", "green": "#3d7d4f"}),
    "rubber": (timber.rubber, {"black": "#34343a"}),
    "kerb": (timber.kerb, {"yellow": "#dfae2a"}),
    "cardboard": (timber.cardboard, {"brown": "#b08d60"}),
    "metal": (
        timber.metal,
        {
            "dark": "#3c4044",
            "black": "#1e1f21",
            "grey": "#84888b",
            "chrome": "#b4b8bb",
            "green": "#35604a",
            "blue": "#2f5586",
            "red": "#a63a30",
            "yellow": "#cfa12f",
        },
    ),
    "plastic": (
        timber.plain,
        {"navy": "#29395c", "orange": "#cc6a2a", "white": "#dcdcd6", "black": "#232427"},
    ),
    "clay": (timber.plain, {"terracotta": "#a8623f"}),
    "bark": (timber.bark, {"brown": "#6b594a"}),
    "car": (timber.car_paint, _CAR_COLOURS),
    # Walls and what is above.
    "plaster": (
        masonry.plaster,
        {
            "white": "#e6e3dc",
            "cream": "#e3d8bf",
            "teal": "#4f8a8b",
            "sage": "#9db09a",
            "ochre": "#d2a65a",
        },
    ),
    "brick": (
        masonry.brick,
        {"red": "#96503e", "brown": "#84604a", "yellow": "#a3835a"},
    ),
    "block_wall": (masonry.block_wall, {"white": "#d9d7d0", "grey": "#8f979c"}),
    "stucco": (masonry.stucco, {"cream": "#d8c8a4", "ochre": "#c59b5f", "rose": "#c99a88"}),
    "panels": (masonry.panels, {"white": "#d6d6d2", "sand": "#c3b397", "grey": "#8e9499"}),
    "corrugated": (
        masonry.corrugated,
        {
            "grey": "#b3b6b8",
            "blue": "#5f7f9f",
            "red": "#9a4334",
            "green": "#4c7a5e",
            "yellow": "#c9a13b",
        },
    ),
    "ceiling_tiles": (masonry.ceiling_tiles, {"white": "#e4e2dd"}),
    "roof": (masonry.roof, {"tile": "#8d5340"}),
    "skirting": (masonry.skirting, {"white": "#dedbd2", "grey": "#6d7072", "oak": "#a87f4f"}),
    "coping": (masonry.coping, {"grey": "#a09c93"}),
    # Windows, doors, lamps.
    "window": (openings.window, {"white": "#e2e0da"}),
    "portal": (openings.portal, {"day": "#060606"}),
    "steel_window": (openings.steel_window, {"green": "#4e625a"}),
    "house_window": (openings.house_window, {"white": "#dedbd2", "dark": "#45494c"}),
    "house_window_lit": (openings.house_window_lit, {"white": "#dedbd2"}),
    "curtain_wall": (openings.curtain_wall, {"grey": "#7d8388"}),
    "glass_doors": (openings.glass_doors, {"grey": "#8b9093"}),
    "door": (
        openings.door,
        {"oak": "#a97c4e", "blue": "#3f648c", "green": "#39594a", "red": "#8c3a31"},
    ),
    "doors": (openings.doors, {"brown": "#7a5537"}),
    "roller_door": (openings.roller_door, {"grey": "#a4a9ac"}),
    "lamp": (openings.lamp, {"white": "#fffaf0"}),
    "glow": (openings.glow, {"warm": "#ffc680"}),
    "milk_glass": (openings.milk_glass, {"white": "#c9cbc8"}),
    "exit": (openings.exit_sign, {"green": "#2aa04f"}),
    # Pictures and fittings.
    "poster": (decor.poster, {"teal": "#2f8085", "red": "#b5402f", "ochre": "#cf9436"}),
    "mural": (decor.mural, {"teal": "#2f8f95", "pink": "#c8527c", "green": "#5f9a3f"}),
    "whiteboard": (decor.whiteboard, {"white": "#e8e9ea"}),
    "pinboard": (decor.pinboard, {"cork": "#b0834f"}),
    "books": (decor.books, {"birch": "#d8bd92"}),
    "pegboard": (decor.pegboard, {"cream": "#c9bc9c"}),
    "sign": (decor.sign, {"white": "#d8dadb"}),
    "sign_board": (decor.sign_board, {"green": "#27503f"}),
    "locker": (decor.locker, {"blue": "#54789c", "grey": "#9a9ea1"}),
    "wall_bars": (decor.wall_bars, {"beech": "#c2935a"}),
    "extinguisher": (decor.extinguisher, {"red": "#b52a22"}),
    "radiator": (decor.radiator, {"white": "#e3e1da"}),
    "wheel": (decor.wheel, _CAR_COLOURS),
    "glass": (decor.dark_glass, {"dark": "#0c0e11"}),
    "grille": (decor.grille, {"chrome": "#a8abae"}),
    "headlight": (timber.plain, {"clear": "#dfe5ea"}),
    "taillight": (timber.plain, {"red": "#a31a17"}),
    "plate": (timber.plain, {"white": "#dcdcd2"}),
    # Leaves have no surface: bake/foliage.py draws them with these colours.
    "leaves": (
        timber.plain,
        {
            "lime": "#7d9440",
            "oak": "#586f33",
            "dark": "#435a30",
            "hedge": "#4a6a32",
            "house": "#3f7038",
            "autumn": "#b07a34",
        },
    ),
}


def colour_of(name: str) -> Colour:
    """Return the linear (3,) colour that a material's name stands for."""
    family, _, shade = name.partition("/")
    colours = _TABLE[family][1]
    return linear(colours[shade] if shade else next(iter(colours.values())))


def is_known(name: str) -> bool:
    """Say whether a name, with its optional colour, is that of a material."""
    family, _, shade = name.partition("/")
    return family in _TABLE and (not shade or shade in _TABLE[family][1])


def coat(name: str, spots: Spots) -> Coat:
    """Return how spots of a material look.

    Raises:
        KeyError: no such material or colour; `is_known` tells before.
    """
    family, _, _ = name.partition("/")
    return _TABLE[family][0](spots, colour_of(name))
