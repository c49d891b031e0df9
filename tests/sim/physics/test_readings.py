"""Readings are the only way out of physics, and belong to any robot, not to Go1 and Go2 alone."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nw_eval
from nw_scenes.robots import RobotSpec
from nw_scenes.robots.spec import CameraMount
from nw_sim.physics import Actuators, World
from nw_sim.tasks.course import CourseProgress, Limits, Termination

HARNESS = Path(nw_eval.__file__).parents[1]

# What makes specifications that `sim` compiles, of terrain and of robots, and sees no world that
# runs.
BEFORE_PHYSICS = {
    "nw_scenes/attach.py",
    "nw_scenes/narrowphase/install.py",
    "nw_scenes/robots/compiled.py",
    "nw_scenes/robots/derived.py",
    "nw_scenes/robots/own_mjcf.py",
    "nw_scenes/robots/looks.py",
    "nw_scenes/robots/standing.py",
}

# A pelvis on two feet, which are so close that they press against each other. A tail swings by
# itself between the two legs that are driven.
MJCF = """
<mujoco model="wader">
  <compiler angle="radian" autolimits="true"/>
  <default><default class="wader"><geom group="3"/></default></default>
  <worldbody>
    <body name="pelvis" pos="0 0 0.5" childclass="wader">
      <freejoint name="floating"/>
      <geom name="hull" type="box" size="0.1 0.2 0.05" mass="4"/>
      <body name="left_shin" pos="0 0.039 -0.05">
        <joint name="left_knee_joint" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.17" size="0.02" mass="0.5"/>
        <body name="left_foot" pos="0 0 -0.2">
          <joint name="left_ankle_joint" axis="0 1 0" range="-1 1"/>
          <geom type="box" size="0.09 0.04 0.01" pos="0.05 0 -0.01" mass="0.2"/>
          <geom type="box" size="0.09 0.04 0.01" pos="-0.05 0 -0.01" mass="0.2"/>
        </body>
      </body>
      <body name="tail" pos="-0.12 0 0">
        <joint name="tail_swing" axis="0 1 0" damping="0.05"/>
        <geom type="sphere" size="0.01" pos="0 0 -0.05" mass="0.1"/>
      </body>
      <body name="right_shin" pos="0 -0.039 -0.05">
        <joint name="right_knee_joint" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.17" size="0.02" mass="0.5"/>
        <body name="right_foot" pos="0 0 -0.2">
          <joint name="right_ankle_joint" axis="0 1 0" range="-1 1"/>
          <geom name="sole" type="box" size="0.1 0.04 0.01" pos="0 0 -0.01" mass="0.5"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="left_knee_joint" joint="left_knee_joint" kp="1" forcerange="-1 1"/>
    <position name="left_ankle_joint" joint="left_ankle_joint" kp="1" forcerange="-1 1"/>
    <position name="right_knee_joint" joint="right_knee_joint" kp="1" forcerange="-1 1"/>
    <position name="right_ankle_joint" joint="right_ankle_joint" kp="1" forcerange="-1 1"/>
  </actuator>
</mujoco>
"""
AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
WADER = RobotSpec(
    name="wader",
    joints=("left_knee_joint", "left_ankle_joint", "right_knee_joint", "right_ankle_joint"),
    default_pose=(0.0, 0.0, 0.0, 0.0),
    joint_ranges=((-1.0, 1.0),) * 4,
    kp=(120.0, 60.0, 110.0, 50.0),
    joint_damping=(3.0, 2.0, 3.0, 2.0),
    torque_limits=(60.0, 40.0, 50.0, 30.0),
    armature=(0.01, 0.02, 0.03, 0.04),
    friction_loss=(0.1, 0.2, 0.3, 0.4),
    root_joint="floating",
    touches="body",
    feet=("right_foot", "left_foot"),
    monitored=("pelvis",),
    published_monitored=("pelvis",),
    fell_tilt=0.9,
    fell_height=0.15,
    collided_force=7.0,
    cameras={"ego": CameraMount(position=(0.1, 0.0, 0.0), R_trunk_camera=AHEAD, fovy=1.5)},
    height_camera_offset=(0.0, 0.0, 25.0),
    bodies=("pelvis", "left_shin", "left_foot", "tail", "right_shin", "right_foot"),
    visuals=(),
    spawn_height=0.28,
    mjcf=MJCF,
)
WEIGHT = 9.806 * 6.0


def attributes(tree):
    """Yield what is read of a private model or data of another object, as text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in {"_model", "_data"}:
            owner = ast.unparse(node.value)
            if owner not in {"self", "cls"}:
                yield f"{owner}.{node.attr}"


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def leaks(source):
    """Return how a module imports MuJoCo or reads a world's inside."""
    tree = ast.parse(source)
    modules = {
        m for m in imported(tree) if m.split(".")[0] == "mujoco" or m == "nw_sim.physics.binding"
    }
    return sorted({*modules, *attributes(tree)})


def test_only_sim_reads_model_and_data_or_imports_mujoco():
    outside = [
        (name, found)
        for file in sorted(HARNESS.rglob("*.py"))
        if not (name := file.relative_to(HARNESS).as_posix()).startswith("nw_sim/physics/")
        and name not in BEFORE_PHYSICS
        and (found := leaks(file.read_text("utf-8")))
    ]
    assert outside == []


def test_what_sim_knows_of_mujoco_has_no_public_name_on_a_world(go1, flat):
    with World(go1, flat) as world:
        assert not {"model", "data"} & {*vars(world), *dir(type(world))}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import mujoco.batch", ["mujoco.batch"]),
        ("def f():\n    from mujoco import MjData", ["mujoco"]),
        ("from nw_sim.physics.binding import mujoco", ["nw_sim.physics.binding"]),
        ("x = trial.world._data.qpos", ["trial.world._data"]),
        ("class A:\n    def f(self):\n        return self._data", []),
    ],
)
def test_a_leak_is_found(source, found):
    assert leaks(source) == found


def test_each_joint_has_figures_of_its_own():
    motors = Actuators.of(WADER)
    np.testing.assert_array_equal(motors.kp, WADER.kp)
    np.testing.assert_array_equal(motors.armature, WADER.armature)


def test_joints_are_found_by_name_where_one_that_nothing_drives_lies_between(flat):
    with World(WADER, flat) as world:
        start = world.joint_positions
        world.reset(position=(0.0, 0.0, 3.0), yaw=0.4, joint_positions=(0.1, 0.2, 0.3, 0.4))
        np.testing.assert_array_equal(world.joint_positions, (0.1, 0.2, 0.3, 0.4))
        assert start.shape == (4,)
        qpos, qvel = world.coordinates()
        # Trunk, left leg, tail, right leg: the tail hangs as it was built.
        np.testing.assert_array_equal(qpos[7:], (0.1, 0.2, 0.0, 0.3, 0.4))
        for _ in range(1):
            world.step((0.5, 0.2, 0.3, 0.4))
        assert world.joint_velocities[0] > 0.1
        assert world.joint_velocities[2] != qvel[8]  # the tail's
        np.testing.assert_array_equal(world.joint_velocities, qvel[[6, 7, 9, 10]])
        *_, positions, velocities, rates = world.moving()
        np.testing.assert_array_equal(positions, world.joint_positions)
        np.testing.assert_array_equal(velocities, world.joint_velocities)
        np.testing.assert_array_equal(rates[:3], world.trunk_linear_velocity)
        np.testing.assert_array_equal(world.torque_limits, WADER.torque_limits)


def test_forces_on_a_foot_are_those_on_all_its_geoms_and_none_of_the_robot_on_itself(flat):
    with World(WADER, flat) as world:
        for _ in range(100):
            world.step(WADER.default_pose)
        forces = world.foot_forces()
        assert world.foot_contacts.all()
        assert forces.sum() == pytest.approx(WEIGHT, rel=0.05)
        assert forces.min() > 0.3 * WEIGHT
        assert world.monitored_force() == 0.0
    of_geoms = replace(WADER, touches="geom", feet=("sole",), monitored=("sole", "hull"))
    with World(of_geoms, flat) as world:
        for _ in range(100):
            world.step(WADER.default_pose)
        # The sole alone, with what the other foot presses against it.
        assert world.foot_forces()[0] > 2.0 * WEIGHT


def test_a_state_of_any_robot_goes_on_bit_for_bit(flat):
    with World(WADER, flat) as world:
        for step in range(30):
            world.step(np.full(4, 0.1 * np.sin(step)))
        saved = world.state()
        for step in range(10):
            world.step(np.full(4, 0.1 * np.sin(step)))
        ended = [part.tobytes() for part in (*world.coordinates(), world.foot_forces())]
        world.restore(saved)
        for step in range(10):
            world.step(np.full(4, 0.1 * np.sin(step)))
        assert [p.tobytes() for p in (*world.coordinates(), world.foot_forces())] == ended


def test_limits_are_the_robots(go1):
    assert Limits.of(go1) == Limits()
    assert Limits.of(WADER) == Limits(tilt=0.9, height=0.15, monitored_force=7.0)


@pytest.mark.parametrize(("level", "outcome"), [(0.0, None), (0.2, "fell")])
def test_a_robot_has_fallen_where_it_is_low_over_what_is_under_it(place, level, outcome):
    # On a platform its trunk is as high over the ground plane as ever.
    box = ((0.0, 0.0, level - 0.6), (1.0, 1.0, 0.5))
    scene = place(*((box,) if level == 0.0 else (((0.0, 0.0, level / 2), (1.0, 1.0, level / 2)),)))
    with World(WADER, scene) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.0)
        assert world.height_over_ground() == pytest.approx(0.3 - level)
        trail = np.array([[4.0, 0.0, 0.0]])
        judge = Termination(trail, (0.0, 0.0), limits=Limits.of(WADER))
        assert judge.check(world, CourseProgress(trail), 1) == outcome


def test_its_own_body_is_not_the_ground_under_it(flat):
    with World(WADER, flat) as world:
        world.reset(position=(0.0, 0.0, 1.5), yaw=0.0)
        assert world.height_over_ground() == pytest.approx(1.5)


def test_feet_have_places_and_widths(flat, go1):
    with World(WADER, flat) as world:
        world.reset(position=(0.0, 0.0, 1.0), yaw=0.0)
        places, widths = world.foot_places()
        np.testing.assert_allclose(places[:, 1], (-0.039, 0.039), atol=1e-9)
        np.testing.assert_allclose(widths, (0.04, 0.04), atol=1e-9)
    with World(go1, flat) as world:
        _, widths = world.foot_places()
        np.testing.assert_array_equal(widths, np.full(4, 0.02))
