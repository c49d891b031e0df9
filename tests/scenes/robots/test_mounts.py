"""Cameras that a robot names, and where its IMU sits."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nw_base.errors import PolicyError, RobotError
from nw_eval.testing import moment_of
from nw_policies.cards import load_card
from nw_policies.cards.control import CameraMounting
from nw_policies.cards.joint_control import mounted_robot
from nw_scenes.mesh import merge, quad_mesh
from nw_scenes.robots import find_robot
from nw_scenes.robots.spec import remounted
from nw_scenes.scene import Scene
from nw_sim.physics import World
from nw_sim.rollout.mcap.images import calibration_message
from nw_sim.rollout.mcap.steps import BodyForms
from nw_sim.sensors import build_sensors
from nw_sim.sensors.build import check_card

# A slab whose neck turns a head; the mast is fixed.
MJCF = """
<mujoco>
  <worldbody>
    <body name="slab" pos="0 0 0.1">
      <freejoint/>
      <geom type="box" size="0.3 0.2 0.05" mass="8"/>
      <site name="imu_in_slab" pos="0.1 0.02 0.03" euler="0 0 90"/>
      <camera name="rear" pos="-0.3 0 0.05" xyaxes="0 1 0 0 0 1" fovy="60"/>
      <body name="mast" pos="0 0 0.2">
        <geom type="sphere" size="0.02" mass="0.1"/>
        <body name="head" pos="0 0 0.1">
          <joint name="neck" axis="0 0 1" range="-90 90"/>
          <geom type="box" size="0.05 0.05 0.05" mass="0.3"/>
          <site name="imu_in_head" pos="0.04 0 0.01"/>
          <camera name="mouth" pos="0.05 0 -0.02" xyaxes="0 -1 0 0 0 1" fovy="50"/>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor>
    <gyro site="imu_in_slab"/><accelerometer site="imu_in_slab"/>
    <gyro site="imu_in_head"/><accelerometer site="imu_in_head"/>
  </sensor>
</mujoco>
"""
YAML = """\
nw-robot: 1
name: nodder
model: {file: nodder.xml}
motors: [{joints: neck, kp: 20, kd: 1, torque: 20}]
eye: {body: mast, position: [0.02, 0, 0]}
cameras:
  left: {body: head, position: [0, 0.05, 0], quaternion: [0.7071068, 0, 0, 0.7071068], pitch: 0.3}
"""
FLAT = Scene(
    name="tests/flat",
    task="hurdles",
    title="",
    solids=(),
    trail=np.array([[2.0, 0.0, 0.0]]),
    static_mesh=merge([]),
    splat=None,
)
CARD = """\
nw-policy: 1
name: looker
robot: nodder
adapter: zero
control: {action: joint_position_offset, scale: 1.0}
observations:
  seen: {sensor: depth, camera: left, width: 8, height: 8, robot: true}
"""


def robot_of(folder, yaml=YAML, mjcf=MJCF):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "nodder.xml").write_text(mjcf)
    (folder / "robot.yaml").write_text(yaml)
    return find_robot(f"{folder}/").spec


def faults(folder, yaml):
    with pytest.raises(RobotError) as caught:
        robot_of(folder, yaml)
    return str(caught.value).replace(f"{folder}/", "")


def turned(world, angle, steps=200):
    for _ in range(steps):
        world.step([angle])


def test_cameras_have_the_names_of_robot_yaml_and_of_the_model(tmp_path):
    robot = robot_of(tmp_path)
    assert [*robot.cameras] == ["ego", "rear", "mouth", "left"]
    assert robot.cameras["ego"].body == robot.cameras["rear"].body == ""
    np.testing.assert_allclose(robot.cameras["ego"].position, [0.02, 0.0, 0.2], atol=1e-12)
    assert robot.cameras["mouth"].body == robot.cameras["left"].body == "head"


def test_a_camera_on_a_head_turns_with_it(tmp_path):
    with World(robot_of(tmp_path), FLAT) as world:
        turned(world, 0.0)
        before = {name: world.camera_pose(name) for name in world.robot.cameras}
        np.testing.assert_allclose(before["mouth"][:3, 2], [1, 0, 0], atol=0.02)
        np.testing.assert_allclose(before["left"][:3, 2], [0, 0.955, -0.296], atol=0.02)
        turned(world, 1.0)
        yaw = world.roll_pitch_yaw[2] + world.joint_positions[0]
        now = world.camera_pose("mouth")
        np.testing.assert_allclose(now[:3, 2], [np.cos(yaw), np.sin(yaw), 0], atol=0.02)
        still = world.camera_pose("rear")[:3, 2]
        assert still @ before["rear"][:3, 2] > 0.95
        assert now[:3, 2] @ before["mouth"][:3, 2] < 0.8


def test_a_card_names_a_camera_of_the_robot_and_does_not_see_the_body_that_carries_it(tmp_path):
    robot_of(tmp_path)
    (tmp_path / "policy.yaml").write_text(CARD)
    card = load_card(tmp_path / "policy.yaml")
    check_card(card)
    with World(find_robot("nodder").spec, FLAT) as world:
        (sensor,) = build_sensors(card, world).values()
        sensor.reset(0)
        depth = sensor.read(moment_of(world))
        assert depth.shape == (8, 8)
        # The head's own box begins where the camera is; a hit of it would be at 0.
        assert depth[depth > 0].min() > 0.2
    lost = card.model_copy(
        update={
            "observations": {"seen": card.observations["seen"].model_copy(update={"camera": "lft"})}
        }
    )
    with pytest.raises(PolicyError, match=r"nodder has no camera 'lft'; did you mean 'left'"):
        check_card(lost)


def test_a_log_has_the_frame_of_a_camera_on_its_own_body(tmp_path):
    with World(robot_of(tmp_path), FLAT) as world:
        turned(world, 1.0)
        robot = world.robot
        forms = BodyForms(
            names=robot.bodies,
            bodies=world.bodies,
            in_model=world.body_count,
            joints=robot.joints,
            cameras={"camera/mouth": world.mounted("mouth")},
            carriers=[robot.bodies.index("head")],
        )
        rows = np.concatenate([np.ravel(each) for each in (*world.moving(), world.torques)])
        poses = forms.numbers(rows[np.newaxis])[0]
        np.testing.assert_allclose(poses[0, -1, :3], world.camera_pose("mouth")[:3, 3], atol=1e-6)


@pytest.mark.parametrize("site", ["imu_in_slab", "imu_in_head"])
def test_an_imu_reads_what_mujocos_own_sensors_read_at_its_site(tmp_path, site):
    robot = robot_of(tmp_path, YAML + f"imu: {{site: {site}}}\n")
    assert robot.imu.body == ("head" if "head" in site else "")
    with World(robot, FLAT) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.4)
        world._data.qvel[:] = [0.3, 0.1, 0.0, 0.5, -0.4, 0.6, 1.0]
        for _ in range(10):
            world.step([0.8])
        spec = mujoco.MjSpec.from_string(robot.mjcf)
        spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_GYRO, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site
        )
        spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site,
        )
        model = spec.compile()
        own = mujoco.MjData(model)
        own.qpos, own.qvel = world._data.qpos, world._data.qvel
        mujoco.mj_forward(model, own)
        np.testing.assert_allclose(world.imu_angular_velocity, own.sensordata[:3], atol=1e-9)
        # Acceleration follows from the world's own contacts and motors.
        model = world._model
        number = model.site(site).id
        expected = np.empty(6)
        mujoco.mj_rnePostConstraint(model, world._data)
        mujoco.mj_objectAcceleration(
            model, world._data, mujoco.mjtObj.mjOBJ_SITE, number, expected, 1
        )
        np.testing.assert_allclose(world.specific_force((0.0, 0.0, 0.0)), expected[3:], atol=1e-6)
        R = own.site(site).xmat.reshape(3, 3)
        np.testing.assert_allclose(world.imu_rotation, R, atol=1e-9)


def test_terms_of_the_card_are_read_at_the_imu(tmp_path):
    robot_of(tmp_path, YAML + "imu: {site: imu_in_head}\n")
    text = CARD.replace(
        "  seen: {sensor: depth, camera: left, width: 8, height: 8, robot: true}\n",
        "  obs: {sensor: proprio, terms: [ang_vel, gravity, acceleration]}\n",
    )
    (tmp_path / "policy.yaml").write_text(text)
    card = load_card(tmp_path / "policy.yaml")
    with World(find_robot("nodder").spec, FLAT) as world:
        turned(world, 1.0, steps=5)  # The neck turns.
        (sensor,) = build_sensors(card, world).values()
        sensor.reset(0)
        seen = sensor.read(moment_of(world))
        np.testing.assert_allclose(seen[:3], world.imu_angular_velocity, rtol=1e-5, atol=1e-7)
        assert abs(seen[2] - world.trunk_angular_velocity[2]) > 1.0
        np.testing.assert_allclose(seen[3:6], -world.imu_rotation[2], atol=1e-6)
        np.testing.assert_allclose(seen[6:], world.specific_force((0, 0, 0)), rtol=1e-5)


def test_a_state_holds_what_an_imu_on_a_head_reads(tmp_path):
    robot = robot_of(tmp_path, YAML + "imu: {body: head, position: [0.04, 0, 0.01]}\n")
    with World(robot, FLAT) as world, World(robot, FLAT) as other:
        turned(world, 1.0, steps=20)
        other.restore(world.state())
        read = world.specific_force((0.0, 0.0, 0.0))
        assert (other.specific_force((0.0, 0.0, 0.0)) == read).all()
        assert (other.imu_angular_velocity == world.imu_angular_velocity).all()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("imu: {site: imu_in_hed}", ":8:7: imu: no site 'imu_in_hed'; did you mean 'imu_in_head'"),
        ("imu: {site: imu_in_head, body: head}", "a site has its own position and axes"),
        ("imu: {body: hed}", "imu.body: no body 'hed'; did you mean 'head'?"),
        ("imu: {quaternion: [0, 0, 0, 0]}", "imu: a quaternion of length 0"),
        (
            "  up: {position: [0, 0, 0], quaternion: [0, 0, 0, 2]}",
            "cameras.up: a quaternion of length 2; give w x y z of length 1",
        ),
        (
            "  up: {position: [0, 0, 0], pitch: 0, rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}",
            ":8:3: cameras.up: `rotation` and `pitch` both say how it is turned; remove one",
        ),
        ("  ego: {position: [0, 0, 0]}", "cameras: `eye` is `ego`, too; remove one"),
        (
            "  up: {body: had, position: [0, 0, 0]}",
            "cameras.up.body: no body 'had'; did you mean 'head'?",
        ),
        ("  a/b: {position: [0, 0, 0]}", "a/b"),
    ],
)
def test_a_mount_that_cannot_be_is_told_with_its_place(tmp_path, line, said):
    assert said in faults(tmp_path, YAML + line + "\n")


INTRINSICS = "{width: 640, height: 480, fx: 610, fy: 612, cx: 330, cy: 236}"


def test_robot_yaml_says_focal_lengths_and_where_the_axis_is(tmp_path):
    yaml = YAML.replace("pitch: 0.3}", f"pitch: 0.3, intrinsics: {INTRINSICS}}}")
    robot = robot_of(tmp_path, yaml)
    lens = robot.cameras["left"].lens(80, 45)  # Another shape: the whole view all the same.
    np.testing.assert_allclose([lens.fx, lens.fy], [610 / 8, 612 * 45 / 480])
    np.testing.assert_allclose([lens.cx, lens.cy], [330 / 8, 236 * 45 / 480])
    angle = np.arctan(236 / 612) + np.arctan(244 / 612)
    assert robot.cameras["left"].fovy == pytest.approx(angle)
    square = robot.cameras["ego"].lens(80, 45)
    assert (square.fx, square.cx, square.cy) == (pytest.approx(22.5), 40.0, 22.5)


def test_a_camera_has_one_view(tmp_path):
    twice = YAML.replace("pitch: 0.3}", f"fovy: 60, intrinsics: {INTRINSICS}}}")
    assert "robot.yaml:7:3: cameras.left: `fovy` and `intrinsics` both" in faults(tmp_path, twice)
    beyond = YAML.replace("pitch: 0.3}", f"intrinsics: {INTRINSICS.replace('330', '3300')}}}")
    assert "cx 3300 is outside of the image of 640 x 480; give" in faults(tmp_path, beyond)


def test_a_cards_intrinsics_take_the_place_of_the_robots_in_depth_and_in_the_log(tmp_path):
    robot_of(tmp_path)
    (tmp_path / "policy.yaml").write_text(
        CARD + f"cameras: {{rear: {{intrinsics: {INTRINSICS}}}}}\n"
    )
    card = load_card(tmp_path / "policy.yaml")
    robot = mounted_robot(find_robot("nodder").spec, card)
    assert remounted(robot.cameras["rear"], pitch=0.0, height=0.1, factor=1.0).intrinsics
    lens = robot.cameras["rear"].lens(64, 48)
    wider = remounted(robot.cameras["rear"], pitch=0.0, height=0.0, factor=1.25)
    assert wider.lens(64, 48).fovy == pytest.approx(1.25 * lens.fovy, rel=1e-4)
    sight = card.observations["seen"].model_copy(
        update={"camera": "rear", "width": 64, "height": 48, "robot": False}
    )
    ground = replace(FLAT, static_mesh=quad_mesh((-9, -9, 0), (18, 0, 0), (0, 18, 0), "ground"))
    with World(robot, ground) as world:
        (sensor,) = build_sensors(
            card.model_copy(update={"observations": {"seen": sight}}), world
        ).values()
        sensor.reset(0)
        depth = sensor.read(moment_of(world))
        pose = world.camera_pose("rear")
    # Ground rows, by hand: how far along the axis a pixel's ray meets z = 0.
    column, row = 50, 44
    ray = pose[:3, :3] @ [(column + 0.5 - 33.0) / 61.0, (row + 0.5 - 23.6) / 61.2, 1.0]
    assert depth[row, column] == pytest.approx(-pose[2, 3] / ray[2], rel=1e-5)
    message = calibration_message(0, "rear", lens)
    np.testing.assert_allclose(list(message.K), [61.0, 0, 33.0, 0, 61.2, 23.6, 0, 0, 1])


def test_a_card_says_a_camera_once_and_keeps_its_digest_without(tmp_path):
    robot_of(tmp_path)
    text = f"cameras: {{rear: {{field_of_view: 0.9, intrinsics: {INTRINSICS}}}}}\n"
    (tmp_path / "policy.yaml").write_text(CARD + text)
    with pytest.raises(PolicyError, match="`field_of_view` and `intrinsics` both"):
        load_card(tmp_path / "policy.yaml")
    assert "intrinsics" not in CameraMounting(pitch=0.1).model_dump()


def test_robot_yaml_and_a_card_say_how_long_a_camera_takes(tmp_path):
    yaml = YAML.replace("pitch: 0.3}", "pitch: 0.3, readout: 0.02, exposure: 0.008}")
    robot = robot_of(tmp_path, yaml)
    left = robot.cameras["left"]
    assert (left.readout, left.exposure) == (0.02, 0.008)
    assert (robot.cameras["rear"].readout, robot.cameras["ego"].exposure) == (0.0, 0.0)
    (tmp_path / "policy.yaml").write_text(
        CARD + "cameras: {left: {readout: 0.0}, rear: {exposure: 0.004, height: 0.1}}\n"
    )
    card = load_card(tmp_path / "policy.yaml")
    mounted = mounted_robot(robot, card).cameras
    assert (mounted["left"].readout, mounted["left"].exposure) == (0.0, 0.008)
    assert (mounted["rear"].readout, mounted["rear"].exposure) == (0.0, 0.004)
    assert card.model_dump()["cameras"]["left"]["readout"] == 0.0, "the card's digest has it"
    assert {"readout", "exposure"}.isdisjoint(CameraMounting(pitch=0.1).model_dump())
    long = YAML.replace("pitch: 0.3}", "pitch: 0.3, readout: 20}")
    said = "robot.yaml:7:100: cameras.left.readout: must be at most 0.1, got 20"
    assert said in faults(tmp_path, long)


@pytest.mark.parametrize("camera", ["mouth", "rear"])
def test_a_camera_moves_as_its_places_of_two_instants_differ(tmp_path, camera):
    with World(robot_of(tmp_path), FLAT) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.4, joint_positions=[0.5])
        world._data.qvel[:] = [0.3, 0.1, -0.2, 0.5, -0.4, 0.6, 1.0]
        world.push((0.0, 0.0))  # What follows from the velocities.
        linear, angular = world.camera_velocity(camera)
        before, later = world.camera_pose(camera), 1e-6
        mujoco.mj_integratePos(world._model, world._data.qpos, world._data.qvel, later)
        mujoco.mj_kinematics(world._model, world._data)
        after = world.camera_pose(camera)
    np.testing.assert_allclose(linear, (after[:3, 3] - before[:3, 3]) / later, atol=1e-5)
    turn = (after[:3, :3] @ before[:3, :3].T - np.eye(3)) / later
    np.testing.assert_allclose(angular, [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-5)
