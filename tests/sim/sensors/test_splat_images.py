from dataclasses import replace

import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_scenes.robots import get_robot
from nw_sim.sensors import build_sensors
from nw_sim.sensors.splat_rgb import arrange, average_blocks
from nw_splat.camera import Pixels
from nw_splat.image import Image

IMAGE = {"sensor": "splat_rgb", "width": 32, "height": 18}


class Painter:
    """A renderer of a grey wall 3 m ahead that gets brighter with every image."""

    def __init__(self):
        self.asked = []

    def render(self, camera, pixels=Pixels()):  # noqa: B008 - the renderer's own signature.
        self.asked.append((camera, pixels))
        shape = (pixels.count(camera.height), pixels.count(camera.width))
        grey = np.full((*shape, 3), len(self.asked) * 10.4 / 255.0, dtype=np.float32)
        depth = np.full(shape, 3.0, dtype=np.float32)
        return Image(rgb=grey, depth=depth, alpha=np.full(shape, 0.75, dtype=np.float32))


@pytest.fixture
def look(world, card_of):
    """A function: a sensor that looks at the painter's wall, and the painter."""

    def look(**options):
        painter = Painter()
        card = card_of({"eye": IMAGE | options})
        sensor = build_sensors(card, world, renderer=lambda _: painter)["eye"]
        sensor.reset(0)
        return sensor, painter

    return look


def test_an_image_is_bytes_truncated(look, world, moment_of):
    sensor, _ = look()
    image = sensor.read(moment_of(world))
    assert image.shape == (18, 32, 3)
    assert image.dtype == np.uint8
    assert np.unique(image).tolist() == [10]  # 10.4 truncated.
    assert sensor.coverage == pytest.approx(0.75)


def test_the_camera_looks_from_the_robots_head_with_its_field_of_view(look, world, moment_of):
    sensor, painter = look()
    sensor.read(moment_of(world))
    camera, pixels = painter.asked[0]
    assert pixels == Pixels()
    # Published Go1: 90 degrees upright, so the focal length is half the height.
    assert camera.fy == pytest.approx(9.0)
    head = world.trunk_position + world.trunk_rotation @ [0.27, 0.0, 0.015]
    np.testing.assert_allclose(camera.T_world_camera[:3, 3], head, atol=1e-9)
    forward = world.trunk_rotation[:, 0]
    np.testing.assert_allclose(camera.T_world_camera[:3, 2], forward, atol=1e-9)


def test_the_published_image_asks_for_its_pixels_only(look, world, moment_of):
    sensor, painter = look(sampling="published", width=80, height=45)
    assert sensor.read(moment_of(world)).shape == (45, 80, 3)
    camera, pixels = painter.asked[0]
    assert (camera.width, camera.height) == (1280, 720)
    assert camera.fy == pytest.approx(360.0)  # Neverwhere's published focal length.
    assert pixels == Pixels(stride=16, block=2, offset=7)


def test_blocks_are_averaged_with_halves_up():
    # floor((a + b + c + d + 2) / 4), by hand.
    image = np.zeros((2, 4, 3), dtype=np.uint8)
    image[..., 0] = [[1, 0, 255, 255], [1, 0, 255, 254]]
    assert average_blocks(image)[0, :, 0].tolist() == [1, 255]


def test_a_slow_camera_renders_no_more_often_than_its_rate(look, world, moment_of):
    sensor, painter = look(rate=10)
    for step in range(11):
        sensor.read(moment_of(world, step=step))
    assert len(painter.asked) == 3


def test_sensors_that_look_the_same_way_share_one_picture(world, card_of, moment_of):
    world.reset(position=(0.0, 0.0, 0.1), yaw=0.0)  # Cones stand 2 m and 4 m ahead.
    painter = Painter()
    size = {"width": 320, "height": 180}
    card = card_of(
        {
            "cones": IMAGE | size | {"cones": True},
            "bytes": IMAGE | size,
            "floats": IMAGE | size | {"dtype": "float32", "stack": 2},
            "small": IMAGE,
        }
    )
    sensors = build_sensors(card, world, renderer=lambda _: painter)
    for step in range(2):
        moment = moment_of(world, step=step)
        images = {name: sensor.read(moment) for name, sensor in sensors.items()}
    assert [camera.width for camera, _ in painter.asked] == [320, 32, 320, 32]
    assert np.unique(images["bytes"]).tolist() == [31]  # Of the third picture, without cones.
    assert (images["cones"] != images["bytes"]).any()
    assert np.unique(images["floats"] * 255).round().tolist() == [10, 31]


def test_a_stack_is_oldest_first_and_starts_with_the_first_image(look, world, moment_of):
    sensor, _ = look(stack=3)
    seen = [sensor.read(moment_of(world, step=step))[:, 0, 0, 0].tolist() for step in range(4)]
    assert seen == [[10, 10, 10], [10, 10, 20], [10, 20, 31], [20, 31, 41]]


def test_a_stack_of_floats_goes_on_where_it_was_restored(look, world, moment_of):
    options = {"stack": 3, "dtype": "float32", "axes": "chw"}
    (first, _), (second, painter) = look(**options), look(**options)
    for step in range(4):
        first.read(moment_of(world, step=step))
    second.read(moment_of(world, step=0))
    second.restore(first.state())
    painter.asked += [None] * 3
    following = moment_of(world, step=4), moment_of(world, step=4)
    expected, seen = first.read(following[0]), second.read(following[1])
    np.testing.assert_array_equal(seen, expected)
    assert (expected[:, 0, 0, 0] * 255).round().tolist() == [31, 41, 52]


def test_float_images_are_normalised_and_channels_come_first(look, world, moment_of):
    sensor, _ = look(dtype="float32", mean=127.5, std=255.0, axes="chw")
    image = sensor.read(moment_of(world))
    assert image.shape == (3, 18, 32)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, (10 - 127.5) / 255.0, rtol=1e-6)


def test_frames_can_be_stacked_along_the_channels(look):
    sensor, _ = look(stack=2, stack_axis="channel", axes="chw")
    frames = [np.full((18, 32, 3), k, dtype=np.uint8) for k in (1, 2)]
    stacked = arrange(frames, sensor._measurement._observation)
    assert stacked.shape == (6, 18, 32) == sensor.shape
    assert stacked[:, 0, 0].tolist() == [1, 1, 1, 2, 2, 2]


def test_a_cone_is_seen_before_the_wall_and_hidden_behind_it(look, world, moment_of):
    world.reset(
        position=(0.0, 0.0, 0.1), yaw=0.0
    )  # Waypoints, with cones, stand 2 m and 4 m ahead.
    plain, _ = look(width=320, height=180)
    painted, _ = look(width=320, height=180, cones=True)
    changed = (plain.read(moment_of(world)) != painted.read(moment_of(world))).any(axis=-1)
    columns = np.flatnonzero(changed.any(axis=0))
    # f = 90 px; 0.18 m wide at about 2 - 0.27 m is 9 px, centred; the far cone is hidden.
    assert 6 <= len(columns) <= 13
    assert columns.mean() == pytest.approx(159.5, abs=1.0)


def test_a_published_cone_is_hidden_by_geometry_not_by_the_splat(look, world, moment_of):
    # The wall of the splat is 3 m away, but the far cone, 3.7 m away, is painted over it.
    world.reset(position=(0.0, 0.0, 0.1), yaw=0.0)
    # So narrow is the far cone that it must stand on a column that is looked at: 8 pixels of 1280
    # right of the middle, at f = 360 pixels.
    trail = np.array([world.scene.trail[0], [4.0, -3.73 * 8.0 / 360.0, 0.0]])
    world.scene = replace(world.scene, trail=trail)
    published = {"sampling": "published", "width": 80, "height": 45}
    plain, _ = look(**published)
    painted, _ = look(**published, cones=True)
    before, after = plain.read(moment_of(world)), painted.read(moment_of(world))
    assert (before != after).any()
    trail[0] = [50.0, 0.0, 0.0]  # Only the far cone is left.
    world.scene = replace(world.scene, trail=trail)
    far, _ = look(**published, cones=True)
    assert (far.read(moment_of(world)) != before).any()
    trail[1, 2] = -0.5  # Under the ground, nothing of it is seen.
    world.scene = replace(world.scene, trail=trail)
    under, _ = look(**published, cones=True)
    np.testing.assert_array_equal(under.read(moment_of(world)), before)


def test_the_robots_legs_are_seen_only_where_the_card_asks(look, world, moment_of):
    world.reset(position=(0.0, 0.0, 0.4), yaw=0.0)
    # Feet far ahead of the head: front thighs forward, calves stretched.
    world._data.qpos[7:] = np.tile([0.0, -0.6, -0.95], 4)
    import mujoco

    mujoco.mj_forward(world._model, world._data)
    plain = look(width=160, height=90)[0].read(moment_of(world))
    with_robot = look(width=160, height=90, robot=True)[0].read(moment_of(world))
    assert (plain != with_robot).any()


def test_a_splat_in_other_units_is_seen_from_the_same_place(world, card_of, moment_of):
    painter = Painter()
    T_world_splat = np.diag([2.0, 2.0, 2.0, 1.0])
    T_world_splat[:3, 3] = [1.0, 2.0, 3.0]
    object.__setattr__(world.scene, "T_world_splat", T_world_splat)
    sensor = build_sensors(card_of({"eye": IMAGE}), world, renderer=lambda _: painter)["eye"]
    sensor.reset(0)
    sensor.read(moment_of(world))
    T = painter.asked[0][0].T_world_camera
    expected = (world.camera_pose("ego")[:3, 3] - [1.0, 2.0, 3.0]) / 2.0
    np.testing.assert_allclose(T[:3, 3], expected, atol=1e-12)
    # A point 3 m ahead of the camera stays at camera depth 3.
    ahead = world.camera_pose("ego") @ [0.0, 0.0, 3.0, 1.0]
    np.testing.assert_allclose(
        np.linalg.inv(T) @ np.linalg.inv(T_world_splat) @ ahead, [0.0, 0.0, 3.0, 1.0], atol=1e-9
    )


def test_a_stack_goes_back_with_its_sensor(look, world, moment_of):
    first, _ = look(stack=2, rate=10, latency=0.04)
    second, painter = look(stack=2, rate=10, latency=0.04)
    for step in range(8):
        first.read(moment_of(world, step=step))
    second.restore(first.state())
    painter.asked = [None] * 2  # The second painter goes on where the first one is.
    for step in range(8, 20):
        expected = first.read(moment_of(world, step=step)).tobytes()
        assert second.read(moment_of(world, step=step)).tobytes() == expected


def test_an_unknown_camera_is_answered_with_the_nearest_one(look):
    with pytest.raises(PolicyError, match="go1 has no camera 'eggo'; did you mean 'ego'"):
        look(camera="eggo")


def test_the_robot_has_the_published_camera():
    assert get_robot("go1").cameras["ego"].fovy == pytest.approx(np.pi / 2)
