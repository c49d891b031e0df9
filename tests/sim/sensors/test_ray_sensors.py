"""Depth, semantics, lidar and height maps against rays cast one by one in NumPy."""

import mujoco
import numpy as np
import pytest

from nw_scenes.mesh import cone_mesh
from nw_scenes.robots import get_robot
from nw_scenes.robots.spec import VISUAL_GROUP
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.drawing.pictures import CLASSES, PALETTE
from nw_sim.sensors.ray_sensors import rotation

BOXES = (((1.3, 0.3, 0.15), (0.15, 0.4, 0.15)), ((2.2, -0.5, 0.6), (0.2, 0.2, 0.6)))
SMALL = {"width": 48, "height": 27}


def nearest_triangle(origin, directions, triangles):
    """Moeller and Trumbore's test of every ray with every triangle, both sides: distance, face."""
    a, ab, ac = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    best = np.full(len(directions), np.inf)
    face = np.full(len(directions), -1)
    for number, ray in enumerate(directions):
        p = np.cross(ray, ac)
        determinant = np.einsum("ij,ij->i", ab, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin - a
            u = np.einsum("ij,ij->i", s, p) / determinant
            q = np.cross(s, ab)
            v = q @ ray / determinant
            t = np.einsum("ij,ij->i", ac, q) / determinant
            hit = (np.abs(determinant) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
        if hit.any():
            face[number] = np.flatnonzero(hit)[t[hit].argmin()]
            best[number] = t[hit].min()
    return best, face


def nearest_of_robot(world, origin, directions):
    """Every primitive that is drawn, one by one, but for those of the trunk."""
    model, data = world._model, world._data
    trunk = model.body("trunk").id
    drawn = [
        g
        for g in range(model.ngeom)
        if model.geom_group[g] == VISUAL_GROUP and model.geom_bodyid[g] != trunk
    ]
    best = np.full(len(directions), np.inf)
    for number, ray in enumerate(directions):
        for g in drawn:
            found = mujoco.mju_rayGeom(
                data.geom_xpos[g],
                data.geom_xmat[g],
                model.geom_size[g],
                origin,
                ray,
                int(model.geom_type[g]),
                None,
            )
            if 0 <= found < best[number]:
                best[number] = found
    return best


def cone_triangles(trail):
    mesh = cone_mesh().mesh
    return np.concatenate([mesh.triangles + waypoint for waypoint in trail])


def pinhole(world, camera, width, height):
    """Origin and unit rays through pixel centres, from the published figures of the camera."""
    pose = world.camera_pose(camera)
    focal = 0.5 * height / np.tan(0.5 * world.robot.cameras[camera].fovy)
    x = (np.arange(width) + 0.5 - width / 2) / focal
    y = (np.arange(height) + 0.5 - height / 2) / focal
    rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1).reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    return pose[:3, 3], (rays / length[:, None]) @ pose[:3, :3].T, 1.0 / length


@pytest.fixture(scope="module")
def box_world():
    from importlib import util
    from pathlib import Path

    spec = util.spec_from_file_location("places", Path(__file__).parent / "conftest.py")
    places = util.module_from_spec(spec)
    spec.loader.exec_module(places)
    scene = places.make_place(*BOXES, trail=((1.1, -0.35, 0.0), (4.0, 0.0, 0.0)))
    with World(get_robot("go1"), scene) as world:
        world.reset(position=(0.1, 0.05, 0.33), yaw=0.1)
        # One thigh up, so that a leg stands before the camera.
        pose = np.array(world.robot.default_pose)
        pose[[1, 2]] = (-0.9, -1.2)
        for step in range(12):
            world.step(pose + 0.05 * np.sin(step + np.arange(12)))
        yield world


@pytest.fixture
def look(card_of, moment_of):
    def look(world, observation, *, seed=0, step=0):
        sensor = build_sensors(card_of({"it": observation}), world)["it"]
        sensor.reset(seed)
        return sensor.read(moment_of(world, step=step))

    return look


def test_depth_is_that_of_every_triangle_tried_by_hand(box_world, look):
    origin, rays, cosine = pinhole(box_world, "ego", 48, 27)
    distance, _ = nearest_triangle(origin, rays, box_world.scene.mesh().triangles)
    expected = np.minimum(distance * cosine, 50.0)
    depth = look(box_world, {"sensor": "depth", **SMALL}).ravel()
    assert depth.dtype == np.float32
    # A ray that grazes an edge may fall to either side of it.
    far_off = ~np.isclose(depth, expected, rtol=2e-5, atol=2e-5)
    assert far_off.mean() < 0.002
    assert (distance < 3.0).any()
    assert (expected == 50.0).any()


def test_cones_and_the_robots_legs_stand_before_what_is_behind_them(box_world, look):
    origin, rays, cosine = pinhole(box_world, "ego", 48, 27)
    static, _ = nearest_triangle(origin, rays, box_world.scene.mesh().triangles)
    cones, _ = nearest_triangle(origin, rays, cone_triangles(box_world.scene.trail))
    legs = nearest_of_robot(box_world, origin, rays)
    assert (cones < static).any(), "no cone in sight, so this test would show nothing"
    assert (legs < static).any(), "no leg in sight, so this test would show nothing"
    for options, others in (
        ({"cones": True}, [cones]),
        ({"robot": True}, [legs]),
        ({"cones": True, "robot": True}, [cones, legs]),
    ):
        expected = np.minimum(np.minimum.reduce([static, *others]) * cosine, 50.0)
        depth = look(box_world, {"sensor": "depth", **SMALL, **options}).ravel()
        assert (~np.isclose(depth, expected, rtol=2e-5, atol=2e-5)).mean() < 0.003


def test_semantics_name_what_is_nearest(box_world, look):
    mesh = box_world.scene.mesh()
    origin, rays, _ = pinhole(box_world, "ego", 48, 27)
    static, face = nearest_triangle(origin, rays, mesh.triangles)
    cones, _ = nearest_triangle(origin, rays, cone_triangles(box_world.scene.trail))
    legs = nearest_of_robot(box_world, origin, rays)
    kinds = np.array(["ground", "obstacle", "structure", "clutter", "overhead"])[mesh.kinds]
    names = np.where(face < 0, "nothing", kinds[face])
    names = np.where(cones < static, "cone", names)
    names = np.where(legs < np.minimum(static, cones), "robot", names)
    request = {"sensor": "semantics", **SMALL, "cones": True, "robot": True}
    seen = look(box_world, request)
    assert seen.dtype == np.uint8
    said = np.array(CLASSES)[seen.ravel()]
    assert (said == names).mean() > 0.995
    assert {"nothing", "ground", "obstacle", "cone", "robot"} <= set(said)
    colours = look(box_world, request | {"values": "colors"})
    np.testing.assert_array_equal(colours, PALETTE[seen])


def test_linear_depth_ends_at_its_clip(box_world, look):
    metres = look(box_world, {"sensor": "depth", **SMALL})
    linear = look(box_world, {"sensor": "depth", **SMALL, "mode": "linear"})
    # Published: clip(d, 0, 5) / 5.
    np.testing.assert_allclose(linear, np.clip(metres, 0, 5) / 5, atol=1e-6)
    assert linear.max() == 1.0


def test_midas_depth_is_inverse_and_fills_its_range_in_each_frame(box_world, look):
    metres = look(box_world, {"sensor": "depth", **SMALL}).astype(np.float64)
    midas = look(box_world, {"sensor": "depth", **SMALL, "mode": "midas"})
    inverse = 1 / metres
    expected = (inverse - inverse.min()) / (inverse.max() - inverse.min())
    np.testing.assert_allclose(midas, expected, atol=1e-5)
    assert (midas.min(), midas.max()) == (0.0, 1.0)


def test_an_image_without_relief_has_no_inverse_depth_but_no_nan_either(look, place):
    with World(get_robot("go1"), place()) as world:
        world.reset(position=(0.0, 0.0, 60.0), yaw=0.0)
        seen = look(world, {"sensor": "depth", **SMALL, "mode": "midas", "far": 1.0})
        assert not seen.any()


def test_supersampling_is_the_mean_of_a_finer_image(box_world, look):
    # The published depth image: 1280 x 720, reduced by area by 4.
    fine = look(box_world, {"sensor": "depth", "width": 96, "height": 54, "mode": "linear"})
    coarse = look(box_world, {"sensor": "depth", **SMALL, "mode": "linear", "supersample": 2})
    np.testing.assert_allclose(coarse, fine.reshape(27, 2, 48, 2).mean(axis=(1, 3)), atol=1e-6)


@pytest.mark.parametrize(
    "pattern",
    [
        {"channels": 8, "columns": 90},
        {"pattern": "solid_state", "channels": 20, "columns": 30, "elevation": [-0.5, 0.2]},
    ],
)
def test_lidar_points_lie_on_what_every_triangle_tried_by_hand_says(box_world, look, pattern):
    mount = {"position": [0.1, 0.02, 0.3], "rpy": [0.02, 0.3, -0.2]}
    request = {"sensor": "lidar", "mount": mount, "max_range": 15.0, **pattern}
    points = look(box_world, request)
    assert points.shape == (pattern["channels"], pattern["columns"], 3)
    hits = points.reshape(-1, 3)
    hits = hits[np.isfinite(hits).all(axis=1)].astype(np.float64)
    assert len(hits) > 100
    # From the sensor's frame to the world, by the figures of the card alone.
    R = box_world.trunk_rotation @ rotation(*mount["rpy"])
    origin = box_world.trunk_position + box_world.trunk_rotation @ mount["position"]
    length = np.linalg.norm(hits, axis=1)
    rays = (hits / length[:, None]) @ R.T
    distance, _ = nearest_triangle(origin, rays, box_world.scene.mesh().triangles)
    assert (~np.isclose(distance, length, rtol=1e-4)).mean() < 0.005


def test_a_spinning_lidar_begins_behind_and_turns_to_the_left(place, look):
    with World(get_robot("go1"), place()) as world:
        world.reset(position=(0.0, 0.0, 0.4), yaw=0.7)
        request = {"sensor": "lidar", "channels": 1, "columns": 4, "elevation": [-0.4, -0.2]}
        x, y, z = look(world, request | {"mount": {"position": [0, 0, 0]}})[0].T
    # One channel looks down by the middle of its limits, 0.3 rad, from 0.4 m.
    out = 0.4 / np.tan(0.3)
    np.testing.assert_allclose(x, [-out, 0, out, 0], atol=1e-4)
    np.testing.assert_allclose(y, [0, -out, 0, out], atol=1e-4)
    np.testing.assert_allclose(z, -0.4, atol=1e-5)


def test_a_ray_that_meets_nothing_in_range_is_a_miss(place, look):
    with World(get_robot("go1"), place()) as world:
        world.reset(position=(0.0, 0.0, 0.4), yaw=0.0)
        level = {"sensor": "lidar", "channels": 2, "columns": 8, "elevation": [0.0, 0.2]}
        assert np.isnan(look(world, level)).all()
        far = look(world, level | {"miss": "max_range", "max_range": 12.0})
        np.testing.assert_allclose(np.linalg.norm(far, axis=-1), 12.0, rtol=1e-6)
        ranges = look(world, level | {"miss": "max_range", "values": "ranges"})
        np.testing.assert_array_equal(ranges, np.full((2, 8), 30.0, dtype=np.float32))
        down = level | {"elevation": [-1.2, -1.0], "values": "ranges"}
        assert np.isfinite(look(world, down)).all()
        assert np.isnan(look(world, down | {"min_range": 2.0})).all()


def test_rotations_are_those_of_roll_pitch_yaw():
    for axis, index in (((1, 0, 0), 0), ((0, 1, 0), 1), ((0, 0, 1), 2)):
        angles, quat, expected = np.zeros(3), np.zeros(4), np.zeros(9)
        angles[index] = 0.4
        mujoco.mju_axisAngle2Quat(quat, np.array(axis, dtype=float), 0.4)
        mujoco.mju_quat2Mat(expected, quat)
        np.testing.assert_allclose(rotation(*angles), expected.reshape(3, 3), atol=1e-12)


def test_scandots_are_a_view_of_the_height_map(box_world, look):
    dots = look(box_world, {"sensor": "scandots", "clip": 9.0})
    grid = {"x": [-0.45, 1.2, 12], "y": [-0.75, 0.75, 11], "clip": 9.0}
    heights = look(box_world, {"sensor": "heightmap", **grid})
    assert heights.shape == (12, 11)
    np.testing.assert_allclose(dots, 0.0143 - 0.3 - heights.ravel(), atol=1e-6)
    assert np.ptp(heights) > 0.29


def test_a_height_map_has_three_references(box_world, look):
    request = {"sensor": "heightmap"}
    z = box_world.trunk_position[2]
    trunk, ground, world = (
        look(box_world, request | {"relative_to": what}) for what in ("trunk", "ground", "world")
    )
    np.testing.assert_allclose(trunk, world - z, atol=1e-6)
    np.testing.assert_allclose(ground, world, atol=1e-6)  # Its ground is at z = 0.
    assert world.max() == pytest.approx(0.3, abs=1e-6)


def test_the_direction_is_the_angle_to_the_waypoint(place, look):
    with World(get_robot("go1"), place(trail=((1.0, 1.0, 0.0),))) as world:
        world.reset(position=(0.0, 0.0, 0.4), yaw=0.2)
        assert look(world, {"sensor": "direction"}) == pytest.approx([np.pi / 4 - 0.2], abs=1e-6)
        both = look(world, {"sensor": "direction", "values": "sine_cosine"})
        angle = np.pi / 4 - 0.2
        assert both == pytest.approx([np.sin(angle), np.cos(angle)], abs=1e-6)
