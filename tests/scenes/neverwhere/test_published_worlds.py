"""Robots on published scenes."""

from dataclasses import replace

import numpy as np
import pytest

from nw_scenes import Box, Plane, Scene
from nw_scenes.mesh import merge
from nw_scenes.neverwhere import load_published
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene, match_scenes
from nw_sim.physics import World


def standing(robot, scene, position=(0.0, 0.0, 0.4), seconds=1.0):
    """Return trunk position, roll, pitch and yaw, and the heights of the feet (4,)."""
    with World(get_robot(robot), scene) as world:
        world.reset(position=position, yaw=0.0)
        for _ in range(round(seconds / world.control_period)):
            world.step(get_robot(robot).default_pose)
        assert world.foot_contacts.all()
        feet = [world._data.geom(name).xpos[2] for name in get_robot(robot).feet]
        return world.trunk_position, world.roll_pitch_yaw, np.array(feet)


def native():
    """The scene of the writer from primitives."""
    return Scene(
        name="native",
        task="hurdles",
        title="",
        solids=(Box(center=(1.7, 0, 0.075), half_size=(0.1, 0.8, 0.075)),),
        trail=np.array([[1.7, 0.0, 0.15]]),
        static_mesh=merge([]),
        splat=None,
        ground=Plane(),
    )


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_a_robot_stands_on_a_scan_as_on_the_primitives_it_shows(writer, robot):
    scan = standing(robot, load_published(writer.write(), robot=robot))
    plain = standing(robot, native())
    radius = {"go1": 0.02, "go2": 0.022}[robot]
    for feet in (scan[2], plain[2]):
        assert feet == pytest.approx(np.full(4, radius), abs=3e-3)
    # Several contacts share a foot on a height field and one carries it on a plane: the stance is
    # stiffer and creeps apart more slowly.
    assert scan[0] == pytest.approx(plain[0], abs=0.02)
    assert scan[1] == pytest.approx(plain[1], abs=0.05)


def test_triangles_and_terrain_carry_the_robot_alike(writer):
    folder = writer.write()
    terrain = standing("go1", load_published(folder), seconds=0.6)
    exact = standing("go1", load_published(folder, collision="triangles"), seconds=0.6)
    assert terrain[2] == pytest.approx(exact[2], abs=3e-3)
    assert terrain[0] == pytest.approx(exact[0], abs=0.02)


def test_friction_of_a_trial_acts_on_terrain(writer):
    scene = load_published(writer.write())
    with World(get_robot("go1"), scene, friction=0.35) as world:
        model = world._model
        static = model.geom_bodyid == 0
        assert model.geom_friction[static, 0] == pytest.approx(0.35)
        assert (model.geom_priority[static] == 1).all()


def test_what_walks_off_a_scan_falls_and_is_caught(writer):
    end = standing("go1", load_published(writer.write()), (0.0, 6.0, 0.4))[0]
    assert -0.6 < end[2] < -0.1


def test_suites_name_published_folders_with_a_prefix(writer):
    folder = writer.write()
    reference = f"neverwhere:{folder.name}"
    (scene,) = match_scenes([reference], folder.parent)
    assert scene.name == "neverwhere/hurdle_stata_v1"
    assert get_scene(f"neverwhere:{folder}").digest == scene.digest


def test_a_seen_but_untouchable_scan_keeps_its_ground(writer):
    scene = load_published(writer.write())
    assert replace(scene, solids=()).mesh() is scene.mesh()
