"""Doors and crates move, collide, and are seen where they are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from tests.sim.sensors.prop_scene import DOOR, SCENE, write_scene

from nw_base.errors import SceneError
from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_scenes.check import check_scene
from nw_scenes.folder import folder_files, load_folder
from nw_scenes.rays import RayScene
from nw_scenes.robots import find_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.drawing.overlay import Overlay, ray_directions
from nw_sim.sensors.drawing.pictures import CLASSES
from nw_sim.sensors.drawing.props import PropPictures, joined
from nw_sim.sensors.heights import ground_under
from nw_sim.sensors.ray_sensors import Surroundings
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.render import open_renderer
from nw_splat.store import open_store

EYE = np.array([0.0, 0.2, 0.3])
BLUE, BROWN = (0.2, 0.35, 0.7), (0.62, 0.45, 0.25)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return load_folder(write_scene(tmp_path_factory.mktemp("yard") / "props"))


@pytest.fixture
def world(scene):
    with World(find_robot("go1").spec, scene) as world:
        yield world


def put(world, *, door=0.0, crate=None):
    """Turn the door, rad, and put the crate's middle somewhere, m."""
    model, data = world._model, world._data
    data.qpos[int(model.joint("prop/door").qposadr[0])] = door
    if crate is not None:
        start = int(model.joint("prop/crate").qposadr[0])
        data.qpos[start : start + 3] = crate
    mujoco.mj_forward(model, data)


def camera_at(T):
    return Camera.from_fovy(width=64, height=36, fovy=0.9, T_world_camera=T)


def picture(scene, world, target=(2.4, 0.05, 0.4)):
    """Return what a camera at `EYE` shows that looks at a point, and its pose."""
    pose = look_at(EYE, np.array(target))
    camera = camera_at(pose)
    image = open_renderer(open_store(scene.splat_store()), "cpu").render(camera)
    return PropPictures(scene).into(
        image,
        world.prop_poses(),
        camera_at,
        directions=ray_directions(camera, Pixels()),
        T_world_camera=pose,
        static=RayScene(scene.mesh()),
    )


def looks(image, colour):
    """Say whether the middle of a picture has a colour's hue: its share of red, green and blue."""
    middle = image.rgb[18, 32]
    return np.abs(middle / middle.sum() - np.array(colour) / sum(colour)).max() < 0.06


def test_a_door_of_triangles_is_drawn_at_its_depth(scene, world):
    image = picture(scene, world)
    assert looks(image, BLUE)
    away = look_at(EYE, np.array([2.4, 0.05, 0.4]))[:3, 2]
    assert image.depth[18, 32] == pytest.approx((2.4 + DOOR[0][0]) / away[0], abs=0.02)
    assert image.alpha[18, 32] == pytest.approx(1.0)


def test_a_door_that_is_open_shows_what_is_behind_it(scene, world):
    put(world, door=-1.4)
    assert not looks(picture(scene, world), BLUE)


def test_a_crate_of_gaussians_hides_the_door_and_is_hidden_by_it(scene, world):
    put(world, crate=(1.6, 0.1, 0.35))
    before = picture(scene, world)
    assert looks(before, BROWN)
    assert before.depth[18, 32] == pytest.approx(1.46, abs=0.06)
    put(world, crate=(3.0, 0.05, 0.4))
    assert looks(picture(scene, world), BLUE)


def test_the_place_hides_props(scene, world):
    put(world, door=-1.4, crate=(4.2, 0.05, 0.4))
    image = picture(scene, world)
    assert not looks(image, BROWN)
    assert image.depth[18, 32] < 3.6


def test_the_nearer_of_two_overlays_hides_the_farther_by_its_coverage():
    def one(red, depth, coverage):
        full = np.full((1, 1), 1.0, np.float32)
        return Overlay(
            rgb=np.array([[[red, 0.0, 0.0]]], np.float32),
            depth=depth * full,
            coverage=coverage * full,
        )

    for order in (1, -1):
        both = joined([one(1.0, 1.0, 0.25), one(0.0, 2.0, 1.0)][::order])
        assert both.coverage.item() == 1.0
        assert both.rgb[0, 0, 0] == pytest.approx(0.25)
        assert both.depth.item() == pytest.approx(0.25 * 1.0 + 0.75 * 2.0)


def test_rays_meet_props_where_they_are_and_tell_their_class(scene, world):
    around = Surroundings(lambda: RayScene(scene.mesh()), cones=False, robot=False)
    moment = SimpleNamespace(world=world)
    rays = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    origin = np.array([0.0, 0.1, 0.3])
    np.testing.assert_allclose(around.distance(moment, origin, rays), [2.38, np.inf], atol=1e-5)
    distance, met = around.classes(moment, origin, rays)
    np.testing.assert_allclose(distance, [2.38, np.inf], atol=1e-5)
    assert [CLASSES[number] for number in met] == ["obstacle", "nothing"]
    put(world, crate=(1.0, 0.1, 0.3))
    assert around.distance(moment, origin, rays)[0] == pytest.approx(0.85)
    put(world, door=-1.4, crate=(0.0, -1.0, 0.3))
    np.testing.assert_allclose(around.distance(moment, origin, rays), [3.4, 0.95], atol=1e-5)


def heights(scene, world, *points):
    """Return the heights at points, (x, y) m."""
    return ground_under(
        lambda: RayScene(scene.mesh()), SimpleNamespace(world=world), np.array(points)
    )


def test_heights_are_those_of_props_where_they_are_now(scene, world):
    door, block, ground = (2.4, 0.05), (1.9, 0.9), (1.0, -1.0)
    np.testing.assert_allclose(
        heights(scene, world, door, block, ground), [DOOR[2][1], 0.5, 0.0], atol=1e-6
    )
    put(world, door=-1.4, crate=(1.9, 0.9, 0.65))  # The crate stands on the block.
    np.testing.assert_allclose(
        heights(scene, world, door, block, ground), [0.0, 0.8, 0.0], atol=1e-6
    )


def test_a_crate_that_lies_on_its_edge_has_the_height_of_its_edge(scene, world):
    put(world, crate=(1.0, -1.0, 0.3))
    start = int(world._model.joint("prop/crate").qposadr[0])
    world._data.qpos[start + 3 : start + 7] = [np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0, 0.0]
    mujoco.mj_forward(world._model, world._data)
    edge = 0.3 + 0.15 * np.sqrt(2.0)
    np.testing.assert_allclose(
        heights(scene, world, (1.0, -1.0), (1.0, -0.9), (1.0, -0.78)),
        [edge, edge - 0.1, 0.0],
        atol=1e-6,
    )


@pytest.mark.parametrize("protocol", [STRICT, NEVERWHERE_2026])
@pytest.mark.parametrize(
    ("sensor", "shift"),
    [
        ({"sensor": "heightmap", "relative_to": "world"}, 0.3),
        ({"sensor": "heightmap", "relative_to": "ground"}, 0.3),
        ({"sensor": "scandots"}, -0.3),
    ],
)
def test_every_sensor_of_heights_sees_a_crate_come(
    scene, sensor, shift, protocol, card_of, moment_of
):
    grid = {"x": [0.45, 1.05, 3], "y": [-0.1, 0.1, 2], **sensor}
    with World(find_robot("go1").spec, scene, protocol=protocol) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.0)
        sensors = build_sensors(card_of({"grid": grid}), world)["grid"]
        measured = []
        for middle in ((3.0, 2.0, 0.15), (0.75, 0.0, 0.15)):
            put(world, crate=middle)
            sensors.reset(0)
            measured.append(np.array(sensors.read(moment_of(world))).reshape(3, 2))
    change = [[0.0, 0.0], [shift, shift], [0.0, 0.0]]
    np.testing.assert_allclose(measured[1] - measured[0], change, atol=1e-4)


def test_a_crate_falls_and_a_hinge_keeps_its_axis_and_its_range(world):
    put(world, crate=(1.0, -1.5, 0.5))
    world._data.qvel[int(world._model.joint("prop/door").dofadr[0])] = -6.0
    angles = []
    for _ in range(100):
        world.step(world.robot.default_pose)
        door, crate = world.prop_poses()
        angles.append(np.arctan2(door[1, 0], door[0, 0]))
    assert crate[2, 3] == pytest.approx(0.15, abs=0.005)
    np.testing.assert_allclose(door[:3, 3], (2.4, 0.5, 0.0), atol=1e-9)
    assert -1.65 < min(angles) < -1.45
    assert angles[0] > -0.2


def test_a_state_has_props_in_it(world):
    state = world.state()
    before = world.prop_poses()
    put(world, door=-1.0, crate=(0.9, 0.9, 0.9))
    world.restore(state)
    np.testing.assert_array_equal(world.prop_poses(), before)


def test_what_a_prop_is_counts_for_the_scene_and_no_prop_counts_for_nothing(scene):
    door, crate = scene.props
    heavier = replace(scene, props=(door, replace(crate, mass=2.0)))
    painted = replace(scene, props=(replace(door, color=(1.0, 0.0, 0.0)), crate))
    none = replace(scene, props=())
    assert len({each.digest for each in (scene, heavier, painted, none)}) == 4
    assert len(scene.splat_stores()) == 2


def test_files_of_props_belong_to_the_scene(tmp_path):
    folder = write_scene(tmp_path / "yard")
    assert {"door.obj", "crate.ply"} <= set(folder_files(folder))


def test_a_prop_where_the_robot_starts_is_in_its_way(scene):
    door, crate = scene.props
    assert "spawn_blocked" not in {finding.code for finding in check_scene(scene)}
    inside = replace(scene, props=(door, replace(crate, position=(0.0, 0.1, 0.3))))
    (found,) = (each for each in check_scene(inside) if each.code == "spawn_blocked")
    assert "the prop 'crate' is where the robot starts" in found.message


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("name: crate", "name: door", "two props are called 'door'"),
        ("splat: crate.ply", "splat: none.ply", "there is no splat 'none.ply'"),
        ("mesh: door.obj", "mesh: door.obj\n    splat: crate.ply", "either `mesh` or `splat`"),
        ("    boxes: [{half_size: [0.15, 0.15, 0.15]}]\n", "", "needs `boxes`"),
        ("range: [-1.5, 1.5]", "range: [1.5, -1.5]", "give the least first"),
        ("axis: [0, 0, 1]", "axis: [0, 0, 0]", "no direction"),
        ("mesh: door.obj", "mesh: ../door.obj", ":10:5: props.0.mesh: '../door.obj' leaves the"),
        ("mesh: door.obj", "mesh: dor.obj", ":10:5: there is no mesh 'dor.obj' beside it"),
        ("type: hinge", "type: free", "a free prop has no 'axis'; remove it, or make"),
    ],
)
def test_a_prop_that_is_wrong_is_refused_with_its_line(tmp_path, old, new, says):
    folder = write_scene(tmp_path / "yard")
    assert old in SCENE
    (folder / "scene.yaml").write_text(SCENE.replace(old, new), encoding="utf-8")
    with pytest.raises(SceneError, match=r"scene\.yaml:\d+:\d+") as error:
        load_folder(folder)
    assert says in str(error.value)
