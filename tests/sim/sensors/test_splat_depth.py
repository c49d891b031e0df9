"""Depth and scans of a splat, against distances of the planes that its Gaussians lie on."""

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import UsageError
from nw_eval.engine.prepare import check_splats
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_splat.gaussians import Gaussians
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store

HALF = 2.0  # m from the middle of the room to its walls
DEPTH = {"sensor": "depth", "width": 80, "height": 60, "source": "splat"}
SCAN = {
    "sensor": "lidar",
    "channels": 12,
    "columns": 360,
    "elevation": [-0.4, 0.3],
    "values": "ranges",
    "source": "splat",
    "mount": {"position": [0.1, 0.05, 0.2], "rpy": [0.05, -0.1, 0.3]},
}


def sheet(origin, u, v, opacity=8.0, step=0.025):
    """Flat Gaussians on a rectangle along axes: centres, standard deviations, logits."""
    origin, u, v = (np.array(part, float) for part in (origin, u, v))
    a = np.arange(0.0, 1.0, step / np.linalg.norm(u))
    b = np.arange(0.0, 1.0, step / np.linalg.norm(v))
    s, t = (part.ravel()[:, np.newaxis] for part in np.meshgrid(a, b))
    spread = np.where(np.cross(u, v) == 0.0, 0.6 * step, 0.001)
    points = origin + s * u + t * v
    return points, np.tile(spread, (len(points), 1)), np.full(len(points), opacity)


def renderer_of(*sheets):
    means, spreads, opacities = (np.concatenate(part) for part in zip(*sheets, strict=True))
    splats = Gaussians(
        means=means,
        log_scales=np.log(spreads),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1)),
        opacity_logits=opacities,
        sh=np.zeros((len(means), 1, 3)),
    )
    store = memory_store(splats)
    return lambda _: CpuRenderer(store, projection="ray")


ROOM = [
    sheet((-HALF, -HALF, 0.0), (2 * HALF, 0, 0), (0, 2 * HALF, 0)),
    *(
        sheet(corner, side, (0, 0, 2.0))
        for corner, side in (
            ((-HALF, -HALF, 0), (2 * HALF, 0, 0)),
            ((-HALF, HALF, 0), (2 * HALF, 0, 0)),
            ((-HALF, -HALF, 0), (0, 2 * HALF, 0)),
            ((HALF, -HALF, 0), (0, 2 * HALF, 0)),
        )
    ),
]


@pytest.fixture
def sense(place, card_of, moment_of):
    """A function: what a sensor of a Go1 at the origin reads, and its world while it does."""

    def sense(observation, renderer, scene=None, yaw=0.0):
        with World(get_robot("go1"), scene or place()) as world:
            world.reset(position=(0.0, 0.0, 0.5), yaw=yaw)
            sensor = build_sensors(card_of({"eye": observation}), world, renderer=renderer)["eye"]
            sensor.reset(0)
            return sensor.read(moment_of(world)).copy()

    return sense


def to_the_room(origin, directions):
    """Distances from a point inside the room to its floor and walls, m."""
    with np.errstate(divide="ignore"):
        to_walls = (np.sign(directions[..., :2]) * HALF - origin[:2]) / directions[..., :2]
        to_floor = np.where(directions[..., 2] < 0, -origin[2] / directions[..., 2], np.inf)
    return np.minimum(to_walls.min(axis=-1), to_floor)


def test_a_scan_of_a_room_of_gaussians_is_a_scan_of_its_planes(sense):
    ranges = sense(SCAN, renderer_of(*ROOM), yaw=0.3)
    points = sense(SCAN | {"values": "points", "max_range": 30.0}, renderer_of(*ROOM), yaw=0.3)
    rays = points / ranges[..., np.newaxis]

    def turn(axis, angle):
        i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        R = np.eye(3)
        R[i, i] = R[j, j] = np.cos(angle)
        R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
        return R

    yaw = turn("z", 0.3)
    origin = yaw @ np.array([0.1, 0.05, 0.2]) + [0.0, 0.0, 0.5]
    directions = rays @ (yaw @ turn("z", 0.3) @ turn("y", -0.1) @ turn("x", 0.05)).T
    below = origin[2] + directions[..., 2] * ranges < 1.9  # The walls end at 2 m.
    off = np.abs(ranges - to_the_room(origin, directions))[below]
    assert below.sum() > 4000
    assert np.isfinite(off).all()
    assert np.median(off) < 0.004
    assert np.percentile(off, 99) < 0.05


def test_depth_is_that_of_a_wall_of_gaussians_and_far_where_none_is(sense, place):
    wall = renderer_of(sheet((2.27, -0.5, 0.0), (0, 1.0, 0), (0, 0, 1.0)))
    depth = sense(DEPTH, wall)
    # A Go1's camera is 0.27 m ahead of the trunk and sees 90 degrees from top to bottom.
    np.testing.assert_allclose(depth[26:35, 35:46], 2.0, atol=0.003)
    assert (depth[:, :25] == 50.0).all()
    assert (depth[:10] == 50.0).all(), "no sky, and no ground either: the splat has none"
    box = place(((1.5, 0.0, 0.5), (0.1, 0.1, 0.5)))
    np.testing.assert_array_equal(sense(DEPTH, wall, scene=box), depth)
    through = sense(DEPTH | {"source": "geometry"}, wall, scene=box)
    np.testing.assert_allclose(through[28:32, 38:42], 1.13, atol=1e-3)


def test_a_pole_that_only_the_splat_has_is_met_and_a_veil_is_not(sense):
    pole = sheet((1.5, 0.0, 0.0), (0, 0.12, 0), (0, 0, 1.5), step=0.02)
    seen = sense(DEPTH, renderer_of(*ROOM, pole))
    assert seen[20, 38] == pytest.approx(1.5 - 0.27, abs=0.04)  # Its edges mix.
    assert seen[20, 30] == pytest.approx(HALF - 0.27, abs=0.01)
    veil = sheet((1.5, -1.0, 0.0), (0, 2.0, 0), (0, 0, 1.5), opacity=-2.5)
    assert (sense(DEPTH, renderer_of(veil)) == 50.0).all()
    scan = SCAN | {"elevation": [-0.1, 0.1], "mount": {}}
    assert np.isnan(sense(scan, renderer_of(veil))).all()


def test_cones_and_the_robot_are_met_before_the_splat(sense, place):
    trail = place(trail=((1.5, 0.0, 0.0), (4.0, 0.0, 0.0)))
    bare = sense(DEPTH, renderer_of(*ROOM), scene=trail)
    coned = sense(DEPTH | {"cones": True}, renderer_of(*ROOM), scene=trail)
    nearer = coned < bare - 0.05
    assert 4 < nearer.sum() < 500
    np.testing.assert_array_equal(coned[~nearer], np.minimum(bare, coned)[~nearer])
    assert coned[nearer].min() == pytest.approx(1.5 - 0.27, abs=0.15)


def test_a_card_without_the_key_keeps_its_digest_and_one_with_it_needs_a_splat(card_of, place):
    plain = card_of({"eye": DEPTH | {"source": "geometry"}, "scan": SCAN | {"source": "geometry"}})
    assert all("source" not in seen for seen in plain.model_dump()["observations"].values())
    assert plain.splat_images == []
    card = card_of({"eye": DEPTH, "scan": SCAN})
    assert all(seen["source"] == "splat" for seen in card.model_dump()["observations"].values())
    assert card.splat_images == ["eye", "scan"]
    with pytest.raises(UsageError, match=r"hurdles/test: no splat.*`eye`, `scan`"):
        check_splats(card, [place()])
    with pytest.raises(ValidationError, match="a splat has no rays; drop it"):
        card_of({"eye": DEPTH | {"stereo": {}}})
    with pytest.raises(ValidationError, match=r"at most 1.05 rad up or down, not -1.3; narrow"):
        card_of({"eye": SCAN | {"elevation": [-1.3, 0.2]}})
