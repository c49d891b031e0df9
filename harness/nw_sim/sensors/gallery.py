"""One moment through every sensor, on one labelled sheet; and what the sensors of a card see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_base.files.cache import atomic_path, followed
from nw_policies.cards import Card, mounted_robot
from nw_scenes import Scene
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors.build import build_sensors
from nw_sim.sensors.drawing import pictures
from nw_sim.sensors.drawing.pictures import Bytes, Cell, draw_sheet, text_strip
from nw_sim.sensors.sensor import Sensor, StepContext
from nw_sim.sensors.shutter import shutter_words
from nw_sim.tasks import Course

if TYPE_CHECKING:
    from nw_splat.render import Renderer

PANEL = (400, 225)
"""Width and height of a picture, pixels."""

_ACROSS = 4
_BLANK = 232  # of a panel without a picture
_SETTLING = 50  # control steps in which the robot comes to stand
_BEFORE = 1.1  # m from the first waypoint to where it stands
_MARGIN = 0.3  # m that it may stand behind its spawn


_WIDE = {"width": PANEL[0], "height": PANEL[1]}
_OBSERVATIONS: dict[str, dict[str, Any]] = {
    "photo": {"sensor": "splat_rgb", **_WIDE},
    "objects": {"sensor": "splat_rgb", "cones": True, "robot": True, **_WIDE},
    "small": {"sensor": "splat_rgb", "sampling": "published", "cones": True},
    "classes": {"sensor": "semantics", "cones": True, "robot": True, "values": "colors", **_WIDE},
    "metres": {"sensor": "depth", "cones": True, **_WIDE},
    "linear": {"sensor": "depth", "cones": True, "mode": "linear", **_WIDE},
    "midas": {"sensor": "depth", "cones": True, "mode": "midas", **_WIDE},
    "noisy": {
        "sensor": "depth",
        "noise": {"proportional": 0.03, "dropout": 0.05, "lost": 0.0},
        "wrap": [{"wrapper": "clip", "limits": [0.0, 5.0]}, {"wrapper": "quantize", "step": 0.05}],
    },
    "spinning": {"sensor": "lidar", "channels": 32, "elevation": [-0.6, 0.3], "cones": True},
    "solid": {
        "sensor": "lidar",
        "pattern": "solid_state",
        "channels": 120,
        "columns": 240,
        "elevation": [-0.5, 0.3],
        "cones": True,
    },
    "map": {"sensor": "heightmap", "x": [-0.75, 3.75, 181], "y": [-2.5, 2.5, 201]},
    "dots": {"sensor": "scandots"},
    "direction": {"sensor": "direction"},
    "body": {"sensor": "proprio", "layout": "parkour53"},
}


@dataclass(frozen=True, kw_only=True)
class SeenObservation:
    """What an observation of a card gave in one moment."""

    name: str
    sensor: str
    shape: tuple[int, ...]
    dtype: str
    low: float | None
    """The least of its numbers; None where none is finite."""
    high: float | None
    shutter: str = ""
    """How long its camera takes, in words; empty where that is not a time, and without a camera."""


@dataclass(frozen=True, kw_only=True)
class SeenCard:
    """What the sensors of a card gave in one moment."""

    observations: tuple[SeenObservation, ...]
    picture: Path | None
    """The PNG of those that are images; None if none is."""


def draw_gallery(
    scene: Scene, path: Path, *, robot: str = "go1", renderer: Renderer | None = None
) -> None:
    """Draw what a robot's sensors make of one time step in a scene, as a PNG.

    Args:
        scene: where; without a splat its camera images are left out, and the sheet says so.
        path: of the PNG.
        robot: its name.
        renderer: of the scene's splat (default: opened).

    Raises:
        SceneError: the splat cannot be made. StoreError: the picture cannot be written.
    """
    has_splat = scene.splat is not None or renderer is not None
    shown = {
        name: observation
        for name, observation in _OBSERVATIONS.items()
        if has_splat or observation["sensor"] != "splat_rgb"
    }
    card = Card.model_validate(
        {
            "nw-policy": 1,
            "name": "gallery",
            "robot": robot,
            "adapter": "zero",
            "control": {"action": "joint_position_offset"},
            "observations": shown,
        }
    )
    _, seen = _observe(card, scene, renderer=renderer)
    _write(_panels(seen), path, f"{scene.name}: what the sensors of {robot} make of one time step")


def draw_card(
    card: Card,
    scene: Scene,
    path: Path,
    *,
    code_from: Path | None = None,
) -> SeenCard:
    """Draw those observations of a policy's card that are images, and describe all of them.

    Args:
        card: whose observations.
        scene: where the robot stands.
        path: of the PNG; nothing is written if no observation is an image.
        code_from: as for `build_sensors`.

    Raises:
        PolicyError: an observation cannot be made. StoreError: the PNG cannot be written.
    """
    sensors, seen = _observe(card, scene, code_from=code_from)
    shutters = {
        name: shutter_words(mount.readout, mount.exposure)
        for name, mount in mounted_robot(get_robot(card.robot), card).cameras.items()
    }
    observations: list[SeenObservation] = []
    cells: list[Cell] = []
    for name, sample in seen.items():
        kind = card.observations[name]
        form = f"{' x '.join(map(str, sample.shape))} {sample.dtype}"
        finite = sample[np.isfinite(sample)]
        observations.append(
            SeenObservation(
                name=name,
                sensor=kind.sensor,
                shape=sample.shape,
                dtype=str(sample.dtype),
                low=float(finite.min()) if finite.size else None,
                high=float(finite.max()) if finite.size else None,
                shutter=shutters.get(getattr(kind, "camera", ""), ""),
            )
        )
        is_grey = any(wrap.wrapper == "grayscale" for wrap in kind.wrap)
        image = pictures.picture_of(sample, "" if is_grey else sensors[name].unit)
        if image is not None:
            wrapped = "".join(f" > {wrap.wrapper}" for wrap in kind.wrap)
            caption = f"{kind.sensor}{wrapped}: {form}"
            large = pictures.enlarged(image, PANEL)
            cells.append(Cell(name=name, caption=caption, images=[large]))
    if cells:
        _write(cells, path, f"{scene.name}: what {card.name} sees")
    return SeenCard(observations=tuple(observations), picture=path if cells else None)


def _write(cells: Sequence[Cell], path: Path, title: str) -> None:
    """Write panels in rows of four as a PNG.

    Raises:
        StoreError: it cannot be written.
    """
    picture = draw_sheet(cells, across=_ACROSS, title=title)
    with atomic_path(followed(path)) as temporary:
        temporary.write_bytes(picture)


def _observe(
    card: Card,
    scene: Scene,
    *,
    renderer: Renderer | None = None,
    code_from: Path | None = None,
) -> tuple[dict[str, Sensor], dict[str, NDArray[Any]]]:
    """Let the robot stand before the first waypoint, and read all sensors there once."""
    robot = mounted_robot(get_robot(card.robot), card)
    with World(robot, scene) as world:
        start = np.array(scene.spawn.position[:2])
        way = scene.trail[0, :2] - start
        length = float(np.linalg.norm(way))
        heading = way / length if length > 0.0 else np.array([1.0, 0.0])
        x, y = start + heading * max(length - _BEFORE, -_MARGIN)
        height = scene.spawn.position[2] + robot.spawn_height
        # A little to the side of the way, so that the direction to go is not just ahead.
        yaw = float(np.arctan2(heading[1], heading[0])) - 0.15
        world.reset(position=(x, y, height), yaw=yaw)
        for _ in range(_SETTLING):
            world.step(robot.standing_targets)
        opened = None if renderer is None else lambda _scene: renderer
        sensors = build_sensors(card, world, renderer=opened, code_from=code_from)
        for sensor in sensors.values():
            sensor.reset(0)
        moment = StepContext(
            world=world,
            task=Course.along(scene.trail),
            step=_SETTLING,
            applied_action=np.zeros(len(robot.joints)),
            last_output=np.zeros(len(robot.joints)),
        )
        return sensors, {name: sensor.read(moment) for name, sensor in sensors.items()}


def _panels(seen: dict[str, NDArray[Any]]) -> list[Cell]:
    grid = _OBSERVATIONS["map"]
    third = (PANEL[0] // 3, PANEL[1])
    numbers = [
        pictures.dots_from_above(-seen["dots"].reshape(12, 11), third),
        pictures.arrow(float(seen["direction"][0]), third),
        pictures.bars(seen["body"], (PANEL[0] - 2 * third[0], PANEL[1])),
    ]
    shown = {
        "splat_rgb": ("the scene as a camera sees it", _photo(seen, "photo")),
        "splat_rgb, cones and robot": (
            "objects drawn into the splat, hidden by geometry and lit like it",
            _photo(seen, "objects"),
        ),
        "splat_rgb, published": (
            "80 x 45 from 2 x 2 blocks of 1280 x 720",
            _photo(seen, "small"),
        ),
        "semantics": ("ground, obstacle, structure, clutter, cone, robot", seen["classes"]),
        "depth, metres": ("along the optical axis, 0 to 8 m", _depth(seen["metres"], 8.0)),
        "depth, linear": ("clipped at 5 m", _depth(seen["linear"], 1.0, "gray")),
        "depth, MiDaS": ("1 / depth, stretched in each frame", _depth(seen["midas"], 1.0, "magma")),
        "depth, wrapped": (
            "80 x 45; noise, dropout > clip > quantize",
            pictures.enlarged(_depth(seen["noisy"], 5.0), PANEL),
        ),
        "lidar, spinning": (
            "32 x 1800 rays, from behind; colour is height",
            pictures.points_from_behind(seen["spinning"].reshape(-1, 3), PANEL),
        ),
        "lidar, solid state": (
            "120 x 240 rays",
            pictures.points_from_behind(seen["solid"].reshape(-1, 3), PANEL),
        ),
        "heightmap": (
            f"{grid['x'][2]} x {grid['y'][2]} points of 2.5 cm, ahead is up",
            pictures.map_from_above(seen["map"], PANEL),
        ),
        "scandots, direction, proprio": (
            "132 heights; the way to go; the 53 numbers of the body",
            np.concatenate(numbers, axis=1),
        ),
    }
    return [
        Cell(name=name, caption=caption, images=[image]) for name, (caption, image) in shown.items()
    ]


def _photo(seen: dict[str, NDArray[Any]], name: str) -> Bytes:
    """Return a camera's image, or a panel that says why there is none."""
    if name in seen:
        return pictures.enlarged(seen[name], PANEL)
    strip = np.asarray(text_strip("no splat, so no camera images", PANEL[0] - 80, size=14))
    paper = np.full((PANEL[1], PANEL[0], 3), _BLANK, dtype=np.uint8)
    top = (PANEL[1] - len(strip)) // 2
    paper[top : top + len(strip), 80:] = np.minimum(strip, _BLANK)
    return paper


def _depth(values: NDArray[Any], high: float, colours: str = "turbo") -> Bytes:
    return pictures.coloured(values, 0.0, high, colours)
