"""Sensors: listed, and drawn as a card sees them."""

from __future__ import annotations

from pathlib import Path


def list_sensors() -> str:
    """Return the sensors and wrappers that cards can name, with the packages of plug-ins."""
    from nw_eval.cards.observations import BUILT_IN_SENSORS
    from nw_eval.cards.observations.plugins import SENSORS, WRAPPERS
    from nw_eval.cards.observations.wrappers import BUILT_IN_WRAPPERS
    from nw_eval.sensors.plugins import usable

    lines: list[str] = []
    for group, built_in in ((SENSORS, BUILT_IN_SENSORS), (WRAPPERS, BUILT_IN_WRAPPERS)):
        lines.append(f"{group}: {', '.join(built_in)}")
        lines += [f"  {name} of {package}" for name, package in usable(group, built_in).items()]
    return "\n".join(lines)


def draw_sensors(policy: str | None, *, scene: str, out: Path, allow_code: bool = False) -> str:
    """Draw what a card's sensors see, or one frame of every sensor; return the shapes in words.

    Raises:
        SceneError, PolicyError, UsageError: scene or policy cannot be used.
    """
    from nw_eval.catalogue import get_scene
    from nw_eval.policies import load_bundle
    from nw_eval.sensors.gallery import draw_card, draw_gallery

    place = get_scene(scene)
    if policy is None:
        draw_gallery(place, out)
        return ""
    bundle = load_bundle(policy)
    return draw_card(bundle.card, place, out, code_from=bundle.folder if allow_code else None)
