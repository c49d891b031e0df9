"""Cones in pictures of a splat: whole where geometry shows them, and in the picture's light."""

from dataclasses import replace

import numpy as np
import pytest

from nw_scenes.rays import RayScene
from nw_sim.sensors import build_sensors
from nw_sim.sensors.drawing.overlay import Cones, cone_mask, light_around, ray_directions
from nw_splat.camera import Camera, Pixels
from nw_splat.image import Image

SIZE = {"width": 160, "height": 90}


class Ground:
    """A renderer of grey ground whose surface has waves, as the discs of a splat's have."""

    def __init__(self, *, grey=0.46, waves=0.02):
        self.grey, self.waves = grey, waves

    def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
        directions = ray_directions(camera, pixels)
        down = -(directions @ camera.T_world_camera[2, :3])
        column = np.arange(down.shape[1])
        height = camera.T_world_camera[2, 3] - self.waves * np.cos(column / 3.0)
        distance = height / np.maximum(down, 1e-3)
        is_ground = down > 0.01
        rgb = np.where(is_ground[..., np.newaxis], self.grey, 0.9)
        return Image(
            rgb=np.broadcast_to(rgb, directions.shape).astype(np.float32),
            depth=np.where(is_ground, distance * directions[..., 2], 90.0).astype(np.float32),
            alpha=np.ones(down.shape, dtype=np.float32),
        )


class Nothing:
    def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
        shape = (pixels.count(camera.height), pixels.count(camera.width))
        zero = np.zeros(shape, dtype=np.float32)
        return Image(rgb=np.ones((*shape, 3), dtype=np.float32), depth=zero, alpha=zero)


@pytest.fixture
def see(world, card_of, moment_of):
    """A function: what a camera shows whose splat a renderer draws."""

    def see(renderer, **options):
        card = card_of({"eye": {"sensor": "splat_rgb", **SIZE, **options}})
        sensor = build_sensors(card, world, renderer=lambda _: renderer)["eye"]
        sensor.reset(0)
        return sensor.read(moment_of(world)).astype(float)

    return see


@pytest.fixture
def before_a_cone(world):
    """Put the eye 50 cm before the one cone, 2 m ahead; return the pixels that it must be in."""
    trail = np.array([world.scene.trail[0], [50.0, 0.0, -0.5]])
    world.scene = replace(world.scene, trail=trail)
    world.reset(position=(1.23, 0.0, 0.3), yaw=0.0)
    fovy = world.robot.cameras["ego"].fovy
    camera = Camera.from_fovy(**SIZE, fovy=fovy, T_world_camera=np.eye(4))
    _, mask = cone_mask(
        ray_directions(camera, Pixels()),
        world.camera_pose("ego"),
        cones=Cones(world.scene.trail),
        static=RayScene(world.scene.mesh()),
        robot=world,
    )
    return mask


def test_a_cone_is_whole_though_the_splats_ground_has_waves(see, before_a_cone):
    plain, painted = see(Ground()), see(Ground(), cones=True)
    changed = (plain != painted).any(axis=-1)
    assert before_a_cone.sum() > 150
    # Its foot too, to the last row, where the splat's ground rises before it.
    assert changed[before_a_cone].all()
    rows = np.flatnonzero(changed.any(axis=1))
    assert (np.diff(rows) == 1).all()
    assert changed.sum() < 1.5 * before_a_cone.sum()


def test_what_only_the_splat_shows_hides_a_cone(see, before_a_cone):
    class Screen(Ground):
        def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
            image = super().render(camera, pixels)
            image.depth[:, :80] = np.minimum(image.depth[:, :80], 0.2)
            return image

    changed = (see(Screen()) != see(Screen(), cones=True)).any(axis=-1)
    assert not changed[:, :80].any()
    assert changed[:, 80:][before_a_cone[:, 80:]].all()


def test_geometry_hides_a_cone_where_the_splat_has_a_hole(see, before_a_cone, world):
    assert before_a_cone.any()
    trail = np.array([[3.0, 0.0, -0.3], world.scene.trail[1]])  # In view, but for the ground.
    world.scene = replace(world.scene, trail=trail)
    np.testing.assert_array_equal(see(Nothing(), cones=True), see(Nothing()))


def test_a_cone_in_the_dark_is_as_dark_as_the_ground_around_it(see, before_a_cone):
    day, night = see(Ground(), cones=True), see(Ground(grey=0.14), cones=True)
    ratio = night[before_a_cone].mean() / day[before_a_cone].mean()
    assert ratio == pytest.approx(0.14 / 0.46, rel=0.1)


def picture(colour, shape=(90, 160)):
    return np.broadcast_to(np.asarray(colour, dtype=np.float32), (*shape, 3))


@pytest.mark.parametrize("shape", [(90, 160), (45, 80), (7, 5), (451, 803)])
def test_grey_ground_leaves_colours_alone_and_dim_ground_dims_them(shape):
    row, column = np.array([0, shape[0] - 1]), np.array([shape[1] - 1, 0])
    down = np.ones(shape)
    assert light_around(picture([0.46] * 3, shape), down, row, column) == pytest.approx(1.0)
    assert light_around(picture([0.23] * 3, shape), down, row, column) == pytest.approx(0.5)


def test_the_sky_does_not_count_where_there_is_ground():
    bright = picture([0.3] * 3).copy()
    bright[:45] = 1.0
    down = np.where(np.arange(90) < 45, -0.5, 0.5)[:, np.newaxis] * np.ones(160)
    light = light_around(bright, down, np.array([20, 44, 80]), np.array([80, 80, 80]))
    assert light == pytest.approx(0.3 / 0.46, rel=0.02)


def test_light_is_that_of_the_place_in_the_picture_and_has_its_tint():
    two = picture([0.12] * 3).copy()
    two[:, 80:] = [0.46, 0.40, 0.30]
    dark, warm = light_around(two, np.ones((90, 160)), np.array([45, 45]), np.array([15, 145]))
    assert dark == pytest.approx(0.12 / 0.46, rel=0.05)
    assert warm[0] > warm[1] > warm[2] > 2.0 * dark[2]


def test_rays_far_from_every_cone_are_not_cast_and_none_is_missed():
    waypoints = np.array([[1.0, 0.0, 0.0], [2.0, 0.6, 0.1], [0.1, 0.0, 0.1]])
    rng = np.random.default_rng(5)
    rays = rng.normal(size=(20000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cones = Cones(waypoints)
    for origin in (np.array([0.0, 0.0, 0.2]), np.array([-3.0, 1.0, 0.5])):
        every = cones._rays.distance(np.broadcast_to(origin, rays.shape), rays)
        np.testing.assert_array_equal(cones.distance(origin, rays), every)
        np.testing.assert_array_equal(cones.cast(origin, rays)[0], every)
    assert len(cones._near(np.array([-3.0, 1.0, 0.5]), rays)) < len(rays) / 10
