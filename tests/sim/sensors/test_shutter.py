"""Cameras that take time, against what geometry says of edges that move past them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from tests.sim.sensors.prop_scene import write_scene

from nw_policies.cards import mounted_robot
from nw_scenes.folder import load_folder
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.shutter import Shutter, moved
from nw_splat.camera import Camera, Pixels
from nw_splat.gaussians import Gaussians
from nw_splat.image import Image, exposed
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store

WALL = 2.0  # m ahead of the camera
FOCAL, WIDTH, HEIGHT = 60.0, 96, 48
LENS = {"width": WIDTH, "height": HEIGHT, "fx": FOCAL, "fy": FOCAL, "cx": 48.0, "cy": 24.0}
EYE = {"sensor": "splat_rgb", "width": WIDTH, "height": HEIGHT}
HEAD = np.array([0.27, 0.0, 0.015])  # of the Go1's camera in its trunk
ROWS = (np.arange(HEIGHT) + 0.5) / HEIGHT


@pytest.fixture(scope="module")
def wall():
    """A black wall across the way that ends at y = 0; to the right of it all is white."""
    y, z = np.meshgrid(np.arange(0.0, 1.5, 0.01) + 0.005, np.arange(-0.6, 1.6, 0.01))
    means = np.stack([np.full(y.size, WALL + HEAD[0]), y.ravel(), z.ravel()], axis=-1)
    count = len(means)
    return memory_store(
        Gaussians(
            means=means,
            log_scales=np.log(np.full((count, 3), [0.001, 0.007, 0.007])),
            quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            opacity_logits=np.full(count, 8.0),
            sh=np.full((count, 1, 3), -2.0),
        )
    )


@pytest.fixture
def look(wall, place, card_of, moment_of):
    """A function: what a Go1's camera sees that starts to move as `push` says, (H, W, ...)."""

    def look(push=(0.0, 0.0), spin=0.0, scene=None, sensor=EYE, **shutter):
        card = card_of({"eye": sensor}, cameras={"ego": {"intrinsics": LENS} | shutter})
        with World(mounted_robot(get_robot("go1"), card), scene or place()) as world:
            world.reset(position=(0.0, 0.0, 0.5), yaw=0.0)
            world._data.qvel[5] = spin
            world.push(push)
            eye = build_sensors(card, world, renderer=lambda _: CpuRenderer(wall, samples=4))["eye"]
            eye.reset(0)
            return eye.read(moment_of(world)).copy()

    return look


def light(image):
    """Linear light of display values, IEC 61966-2-1."""
    values = image[..., 0] / 255.0
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def edges(image):
    """The column, in pixels, at which each row of a picture turns from black to white."""
    return 66.0 - light(image[:, 30:66]).sum(axis=1)


def test_a_sideways_step_shears_an_edge_by_the_way_over_the_depth(look):
    still = edges(look())
    moving = edges(look(push=(0.0, 3.0), readout=0.04))
    shear = 3.0 * 0.04 / WALL * FOCAL  # 3.6 pixels, over all rows.
    # The camera moves to the left, and the last row is read where it is now.
    np.testing.assert_allclose(moving - still, -shear * (1.0 - ROWS), atol=0.3)
    slope = np.polyfit(ROWS, moving - still, 1)[0]
    assert slope == pytest.approx(shear, rel=0.03)


def test_a_turn_shears_an_edge_by_the_angle_of_each_row(look):
    spin, readout = 3.0, 0.05
    moved_by = edges(look(spin=spin, readout=readout)) - edges(look())
    # The edge is on the axis now; before, the axis was to the right of it.
    before = spin * readout * (1.0 - ROWS)
    ahead = WALL + HEAD[0] - HEAD[0] * np.cos(before), HEAD[0] * np.sin(before)
    angle = np.arctan2(ahead[1], ahead[0]) + before
    np.testing.assert_allclose(moved_by, -FOCAL * np.tan(angle), atol=0.35)


def test_an_edge_that_moves_while_the_shutter_is_open_is_as_wide_as_its_way(look):
    def where(image, share):
        """The column at which a share of white's light is reached, mean rows."""
        profile = light(image).mean(axis=0)[30:66]
        return np.interp(share, profile, np.arange(len(profile)))

    sharp, smeared = look(), look(push=(0.0, 3.0), exposure=0.04)
    way = 3.0 * 0.04 / WALL * FOCAL  # 3.6 pixels, over which light grows evenly.
    assert (where(smeared, 0.8) - where(smeared, 0.2)) / 0.6 == pytest.approx(way, rel=0.04)
    assert where(sharp, 0.8) - where(sharp, 0.2) < 1.3
    # Its middle is where the edge was in the middle of the exposure.
    middle = edges(smeared) - edges(sharp)
    np.testing.assert_allclose(middle, -way / 2.0, atol=0.15)


def test_light_is_averaged_and_not_display_values():
    black, white = (
        Image(
            rgb=np.full((1, 1, 3), grey, np.float32),
            depth=np.full((1, 1), depth, np.float32),
            alpha=np.full((1, 1), alpha, np.float32),
        )
        for grey, depth, alpha in ((0.0, 0.0, 0.0), (1.3, 4.0, 1.0))
    )
    mean = exposed([black, white])
    assert mean.rgb == pytest.approx(0.7354, abs=1e-4)  # sRGB of half the light
    assert mean.depth == pytest.approx(4.0)
    assert mean.alpha == pytest.approx(0.5)
    assert exposed([white]) is white


def test_a_camera_at_rest_sees_the_same_bits_with_and_without_a_shutter(look):
    np.testing.assert_array_equal(look(readout=0.03, exposure=0.02), look())
    np.testing.assert_array_equal(
        look(push=(1.0, 2.0), readout=0.0, exposure=0.0), look((1.0, 2.0))
    )


@pytest.mark.parametrize("sensor", ["depth", "semantics"])
def test_depth_and_classes_shear_with_the_picture(look, place, sensor):
    box = place(((WALL + HEAD[0] + 1.0, -2.0, 0.5), (1.0, 2.0, 3.0)))
    spec = {"sensor": sensor, "width": WIDTH, "height": HEIGHT}
    seen = look(push=(0.0, 3.0), readout=0.04, scene=box, sensor=spec)
    on_box = np.isclose(seen, WALL, atol=1e-3) if sensor == "depth" else seen == seen[0, -1]
    shear = 3.0 * 0.04 / WALL * FOCAL
    rows = slice(0, 24)  # Above the ground.
    edge = WIDTH - on_box.sum(axis=1)[rows]
    np.testing.assert_allclose(edge, 48.0 - shear * (1.0 - ROWS[rows]), atol=0.85)


def test_each_row_shows_place_props_and_cones_from_where_the_camera_was_then(
    tmp_path, card_of, moment_of, monkeypatch
):
    scene = load_folder(write_scene(tmp_path / "props"))
    go1, eye = get_robot("go1"), {"eye": EYE | {"cones": True}}
    rolling = card_of(eye, cameras={"ego": {"intrinsics": LENS, "readout": 0.05}})
    instant = card_of(eye, cameras={"ego": {"intrinsics": LENS}})

    def sensor_of(card, world):
        world.reset(position=(0.0, 0.0, 0.4), yaw=0.0)
        sensor = build_sensors(card, world)["eye"]
        sensor.reset(0)
        return sensor

    with World(mounted_robot(go1, rolling), scene) as world:
        sensor, mount = sensor_of(rolling, world), world.robot.cameras["ego"]
        world._data.qvel[5] = 1.5
        world.push((0.0, 1.0))
        picture = sensor.read(moment_of(world)).astype(float)
        camera = Camera.of(mount.lens(WIDTH, HEIGHT), np.eye(4))
        bands = Shutter("ego", mount, camera, Pixels()).bands(world)
    off = []
    with World(mounted_robot(go1, instant), scene) as world:
        sensor = sensor_of(instant, world)
        for band in bands:
            monkeypatch.setattr(world, "camera_pose", lambda _, T=band.T_world_camera: T)
            sensor.reset(0)
            whole = sensor.read(moment_of(world)).astype(float)
            off.append(np.abs(whole - picture)[slice(*band.rows)])
    assert len(bands) > 16
    # The light on cones and doors is told from a whole picture, which is another one here.
    assert np.concatenate(off).max() < 4.0
    assert np.abs(whole - picture).max() > 60.0


def test_the_robots_own_body_stands_to_its_camera_as_it_does_now(place, card_of, moment_of):
    robot = get_robot("go1")
    down = ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    above = replace(robot.cameras["ego"], position=(0.0, 0.0, 0.5), R_trunk_camera=down)
    card = card_of({"eye": {"sensor": "depth", "width": 48, "height": 48, "robot": True}})

    def seen(mount, spin):
        with World(replace(robot, cameras={"ego": mount}), place()) as world:
            world.reset(position=(0.0, 0.0, 0.5), yaw=0.0)
            world._data.qvel[5] = spin
            world.push((0.0, spin / 3.0))
            eye = build_sensors(card, world)["eye"]
            eye.reset(0)
            return eye.read(moment_of(world)).copy()

    still, moving = seen(above, 0.0), seen(replace(above, readout=0.05), 6.0)
    legs = still < 0.85  # And 1 m to the ground.
    assert legs.sum() > 50
    np.testing.assert_allclose(moving[legs], still[legs], atol=1e-5)


def test_a_pose_at_another_time_is_what_mujoco_integrates():
    rng = np.random.default_rng(3)
    quat = rng.normal(size=4)
    quat /= np.linalg.norm(quat)
    velocity, time = rng.normal(size=(2, 3)) * 3.0, -0.07
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, quat)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R.reshape(3, 3), rng.normal(size=3)
    own = R.reshape(3, 3).T @ velocity[1]  # MuJoCo takes it along the body's axes.
    mujoco.mju_quatIntegrate(quat, own, time)
    mujoco.mju_quat2Mat(R, quat)
    then = moved(pose, (velocity[0], velocity[1]), time)
    np.testing.assert_allclose(then[:3, :3], R.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(then[:3, 3], pose[:3, 3] + time * velocity[0], atol=1e-12)


@pytest.mark.parametrize(("spin", "count"), [(0.01, 1), (1.0, 4), (40.0, HEIGHT)])
def test_bands_are_as_many_as_the_motion_needs_and_cover_all_rows(place, spin, count):
    mount = replace(get_robot("go1").cameras["ego"], readout=0.05)
    camera = Camera.of(mount.lens(WIDTH, HEIGHT), np.eye(4))
    with World(get_robot("go1"), place()) as world:
        world.reset(position=(0.0, 0.0, 0.5), yaw=0.0)
        world._data.qvel[5] = spin
        world.push((0.0, 0.0))
        bands = Shutter("ego", mount, camera, Pixels()).bands(world)
    assert len(bands) == count
    assert [row for band in bands for row in range(*band.rows)] == list(range(HEIGHT))
