"""Sensors: listed, and drawn as a card sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_sim.sensors.gallery import SeenCard

Listed = Literal["sensor", "wrapper"]


@dataclass(frozen=True, kw_only=True)
class ListedSensor:
    """A sensor or a wrapper that cards can name."""

    name: str
    kind: Listed
    package: str | None = None
    """The installed package that brings it along; None if it is built in."""


def list_sensors() -> tuple[ListedSensor, ...]:
    """Return the sensors, then the wrappers; of each, those that are built in, then plug-ins.

    A plug-in that cannot be imported is reported as a `PluginWarning` and left out.
    """
    from nw_base.plugins import SENSORS, WRAPPERS, usable
    from nw_policies.cards.observations import BUILT_IN_SENSORS
    from nw_policies.cards.wrappers import BUILT_IN_WRAPPERS

    sensors: list[ListedSensor] = []
    kinds: tuple[tuple[Listed, str, tuple[str, ...]], ...] = (
        ("sensor", SENSORS, tuple(BUILT_IN_SENSORS)),
        ("wrapper", WRAPPERS, tuple(BUILT_IN_WRAPPERS)),
    )
    for kind, group, built_in in kinds:
        sensors += [ListedSensor(name=name, kind=kind) for name in built_in]
        sensors += [
            ListedSensor(name=name, kind=kind, package=package)
            for name, package in usable(group, built_in).items()
        ]
    return tuple(sensors)


def draw_sensors(
    policy: str | None, *, scene: str, out: str | PathLike[str], allow_code: bool = False
) -> SeenCard:
    """Draw what a card's sensors see in a scene, or one frame of every built-in sensor.

    Args:
        policy: a policy's name, folder or card (default: all built-in sensors).
        scene: the scene's name or folder.
        out: the PNG to write, if an observation of the card is an image.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        SceneError: the scene cannot be used.
        PolicyError: the policy cannot be used.
        StoreError: the picture cannot be written.
    """
    from nw_policies import load_bundle
    from nw_sim.catalogue import get_scene
    from nw_sim.sensors.gallery import SeenCard, draw_card, draw_gallery

    out = as_path(out)
    place = get_scene(scene)
    if policy is None:
        draw_gallery(place, out)
        return SeenCard(observations=(), picture=out)
    bundle = load_bundle(policy)
    return draw_card(bundle.card, place, out, code_from=bundle.folder if allow_code else None)
