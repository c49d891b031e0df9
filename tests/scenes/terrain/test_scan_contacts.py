"""Every foot and leg shape on scanned ground does what it does on the plain box beneath.

The truth is MuJoCo's own box (a plane that may slope), under the same options: nothing may stay
under the surface, rest elsewhere than on the box, or slide much farther or less far.
"""

from functools import cache

import mujoco
import numpy as np
import pytest

from nw_scenes.attach import add_height_field, add_triangles
from nw_scenes.narrowphase.triangles import signed_distance
from nw_scenes.robots import get_robot
from nw_scenes.scene import HeightField, Triangles

FRICTION = (1.25, 0.3, 0.3)
CELL = 0.0125  # metres, as compiled near the trail
SPHERE, BOX, CYLINDER = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
)
MASS = 3.0  # kg, a quarter of a Go1
MARGIN = 0.0005
STEPS = 120  # of 5 ms: all but fast slides are at rest by then


def colliding_shapes():
    """Return every kind and size of shape with which Go1 and Go2 touch the world."""
    found = {}
    for name in ("go1", "go2"):
        model = mujoco.MjSpec.from_string(get_robot(name).mjcf).compile()
        for geom in range(model.ngeom):
            if model.geom_conaffinity[geom]:
                size = tuple(model.geom_size[geom].round(4).tolist())
                found[int(model.geom_type[geom]), size] = None
    return sorted(found)


SHAPES = colliding_shapes()
COARSE = 0.06  # metres, of the triangles: what is slow is how many there are


def half_height(kind, size):
    return {SPHERE: size[0], BOX: size[2], CYLINDER: size[1]}[mujoco.mjtGeom(kind)]


LANES = 0.5 * (np.arange(len(SHAPES)) - (len(SHAPES) - 1) / 2)  # y of each shape, metres
UNDER = 0.006  # metres that a shape starts under the surface


def heights(slope, noise, cell):
    """Return x (C,), y (R,) and z (R, C) of the ground, metres; its height is 0 at the origin."""
    x, y = np.arange(-1.2, 4.5, cell), np.arange(LANES[0] - 0.3, LANES[-1] + 0.3, cell)
    z = np.repeat((slope * x)[None], len(y), axis=0)
    return x, y, z + np.random.default_rng(0).normal(0.0, noise, z.shape)


def add_field(spec, x, y, z):
    field = HeightField(
        center=((x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2),
        half_size=((x[-1] - x[0]) / 2, (y[-1] - y[0]) / 2),
        heights=z.astype(np.float32),
        floor=float(z.min()) - 0.5,
    )
    add_height_field(spec, "ground", field, friction=FRICTION, priority=0)


def add_mesh(spec, x, y, z):
    X, Y = np.meshgrid(x, y)
    index = np.arange(z.size, dtype=np.int32).reshape(z.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    mesh = Triangles(vertices=np.stack([X, Y, z], axis=-1).reshape(-1, 3), faces=faces)
    add_triangles(spec, "ground", mesh, friction=FRICTION, priority=0)


def add_box(spec, slope):
    angle = np.arctan(slope)
    spec.worldbody.add_geom(
        type=BOX,
        size=[5, 20, 0.5],
        pos=[0.5 * np.sin(angle), 0, -0.5 * np.cos(angle)],
        quat=[np.cos(angle / 2), 0, -np.sin(angle / 2), 0],
        friction=FRICTION,
    )


@cache
def world(ground, slope=0.0, noise=0.0, step=0.0):
    """Return a model of one ground, of MuJoCo's box or of a scan, with every shape in its lane.

    Args:
        ground: `box`, `height field` or `triangles`.
        slope: rise along x.
        noise: of the heights, metres (standard deviation).
        step: height of a step at x = 0.05, one cell wide, metres.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.option.gravity = [0, 0, -9.806]
    spec.option.iterations = 50
    if ground == "box":
        add_box(spec, slope)
    else:
        x, y, z = heights(slope, noise, CELL if ground == "height field" else COARSE)
        z = z + np.where(x > 0.05, step, 0.0)
        (add_field if ground == "height field" else add_mesh)(spec, x, y, z)
    for kind, size in SHAPES:
        body = spec.worldbody.add_body()
        body.add_freejoint()
        body.add_geom(
            type=kind,
            size=size,
            friction=[1, 0.3, 0.3],
            margin=MARGIN,
            mass=MASS,
            conaffinity=0,  # They meet the ground and not each other.
        )
    return spec.compile()


def moved(model, *, slope=0.0, speed=0.0, along=False, under=0.0, push=0.0, steps=STEPS):
    """Return how high each shape was over the ground, (T, S), and how far it went, (S,), metres.

    Args:
        model: of `world`.
        slope: of its ground.
        speed: m/s at the start, into the ground or along it.
        along: the latter.
        under: how far below the ground the lowest point is at the start, metres.
        push: N into the ground in the first half of the time.
        steps: of the physics.
    """
    angle = np.arctan(slope)
    up = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    ahead = np.array([np.cos(angle), 0.0, np.sin(angle)])
    data = mujoco.MjData(model)
    poses, rates = data.qpos.reshape(-1, 7), data.qvel.reshape(-1, 6)
    start = 0.0031 * ahead + np.column_stack([0 * LANES, LANES + 0.0043, 0 * LANES])
    tall = np.array([half_height(*shape) for shape in SHAPES])
    poses[:, :3] = start + (tall - under)[:, None] * up
    poses[:, 3:] = [np.cos(angle / 2), 0, -np.sin(angle / 2), 0]
    rates[:, :3] = speed * (ahead if along else -up)
    over = np.empty((steps, len(SHAPES)))
    for step in range(steps):
        data.xfrc_applied[1:, :3] = -push * up if step < steps // 2 else 0.0
        mujoco.mj_step(model, data)
        over[step] = lowest(data, up)
    return over, (poses[:, :3] - start) @ ahead


def lowest(data, up):
    """Return how high the lowest point of each shape is over the plane of the ground, (S,)."""
    first = len(data.geom_xpos) - len(SHAPES)
    reach = []
    for number, (kind, size) in enumerate(SHAPES):
        axes = data.geom_xmat[first + number].reshape(3, 3).T @ up
        if kind == SPHERE:
            reach.append(size[0])
        elif kind == CYLINDER:
            reach.append(size[0] * np.hypot(axes[0], axes[1]) + size[1] * abs(axes[2]))
        else:
            reach.append(np.abs(axes) @ np.asarray(size))
    return data.geom_xpos[first:] @ up - np.array(reach)


DEEDS = {
    "fall at 0.5 m/s": {"speed": 0.5},
    "fall at 2 m/s": {"speed": 2.0},
    "fall at 4 m/s": {"speed": 4.0},
    "slide at 0.5 m/s": {"speed": 0.5, "along": True},
    "slide at 4 m/s": {"speed": 4.0, "along": True, "steps": 2 * STEPS},
    "are pressed with 150 N": {"push": 150.0},
    "start 6 mm under": {"under": UNDER},
    "start 24 mm under": {"under": 0.024},
}
TIPS = np.array([kind == CYLINDER for kind, _ in SHAPES])
"""Cylinders stand on end here, and fall over sooner or later for nothing."""


GROUNDS = ["height field", pytest.param("triangles", marks=pytest.mark.nightly)]
"""Triangles are the slow way, with which the other is checked."""


@pytest.mark.parametrize("deed", DEEDS)
@pytest.mark.parametrize("slope", [0.0, 0.3])
@pytest.mark.parametrize("ground", GROUNDS)
def test_on_smooth_ground_shapes_move_as_on_a_plain_box(ground, slope, deed):
    over, went = moved(world(ground, slope), slope=slope, **DEEDS[deed])
    truth, true_went = moved(world("box", slope), slope=slope, **DEEDS[deed])
    assert over[-1].min() > -0.003
    # How deep an edge digs in as a shape tumbles at 4 m/s is chance: by as much as 17 mm on a box.
    assert (over.min(axis=0) - truth.min(axis=0)).min() > -0.01
    assert over[-1][~TIPS] == pytest.approx(truth[-1][~TIPS], abs=0.001)
    assert went[~TIPS] == pytest.approx(true_went[~TIPS], rel=0.1, abs=0.02)


@pytest.mark.parametrize("deed", DEEDS)
@pytest.mark.parametrize("ground", GROUNDS)
def test_nothing_stays_under_noisy_ground(ground, deed):
    over, went = moved(world(ground, noise=0.002), **DEEDS[deed])
    # Valleys of the noise are 6 mm deep, and peaks as high.
    assert over[-1].min() > -0.008
    assert over[-1].max() < 0.012
    assert np.abs(went).max() < 4.0


@pytest.mark.parametrize("speed", [0.5, 1.5, 4.0])
@pytest.mark.parametrize("ground", GROUNDS)
def test_shapes_that_run_against_a_step_are_stopped_and_not_thrown_up(ground, speed):
    height = 0.15
    model = world(ground, step=height)
    data = mujoco.MjData(model)
    poses = data.qpos.reshape(-1, 7)
    tall = np.array([half_height(*shape) for shape in SHAPES])
    front = np.array([size[0] for _, size in SHAPES])
    poses[:, :3] = np.column_stack([0.02 - front, LANES, tall])
    data.qvel.reshape(-1, 6)[:, 0] = speed
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
        # Soft contacts give way by some centimetres at 4 m/s, as those of a box do.
        low = poses[:, 2] < height
        assert poses[low, 0].max() < 0.05 + 0.04
        # A shape may tumble over its own length, but is never lifted by the step's height at once.
        assert (poses[:, 2] - front.clip(tall)).max() < speed**2 / (2 * 9.806) + 0.05
    assert poses[:, 2].min() > 0.0


def test_which_side_of_a_noisy_surface_a_point_is_on_is_told_by_its_height():
    x, y, z = heights(0.1, 0.004, 0.03)
    x, y, z = x[:20], y[:20], z[:20, :20]
    field = HeightField(
        center=((x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2),
        half_size=((x[-1] - x[0]) / 2, (y[-1] - y[0]) / 2),
        heights=z.astype(np.float32),
        floor=-1.0,
    )
    X, Y = np.meshgrid(x, y)
    corners = np.stack([X, Y, z.astype(np.float32)], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 9)
    random = np.random.default_rng(1)
    inner = random.uniform((x[3], y[3]), (x[-4], y[-4]), (4000, 2))
    over = random.uniform(-0.06, 0.06, len(inner))
    points = np.column_stack([inner, field.height(inner) + over])
    signed = np.array([signed_distance(triangles, *point)[0] for point in points])
    told = np.abs(over) > 1e-4  # Single precision of the heights.
    assert (np.sign(signed[told]) == np.sign(over[told])).all()
    assert (np.abs(signed) <= np.abs(over) + 1e-6).all()
