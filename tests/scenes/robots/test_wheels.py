"""Wheels: motors that follow velocities, and cards that drive them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from nw_base.errors import PolicyError, RobotError
from nw_eval.testing import moment_of
from nw_policies.cards import JointControl, actuator_values, load_card, motors_follow
from nw_scenes.mesh import merge
from nw_scenes.robots import find_robot
from nw_scenes.scene import Scene
from nw_sim.physics import World
from nw_sim.rollout.perturbed import TrialSetup
from nw_sim.sensors import build_sensors
from nw_sim.sensors.build import check_card

# A cart whose rear wheels carry it and whose front ones swing on legs; wheels are meshes.
WHEEL = """
        <body name="{0}_wheel" pos="0 0 -0.1">
          <joint name="{0}_wheel" axis="0 1 0"/>
          <geom type="mesh" mesh="wheel" mass="0.5" friction="1 0.005 0.0001"/>
        </body>"""
LEG = """
      <body name="{0}_leg" pos="{1} {2} 0">
        <joint name="{0}_leg" axis="0 1 0" range="-40 40" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.05" size="0.01" mass="0.2"/>""" + (
    WHEEL + "\n      </body>"
)
CORNERS = {"fr": (0.2, -0.15), "fl": (0.2, 0.15), "rr": (-0.2, -0.15), "rl": (-0.2, 0.15)}
MJCF = f"""
<mujoco>
  <asset><mesh name="wheel" file="wheel.stl"/></asset>
  <worldbody>
    <body name="deck" pos="0 0 0.3">
      <freejoint/>
      <geom type="box" size="0.25 0.1 0.03" mass="4"/>
      {"".join(LEG.format(name, x, y) for name, (x, y) in CORNERS.items())}
    </body>
  </worldbody>
</mujoco>
"""
YAML = """\
nw-robot: 1
name: cart
model: {file: cart.xml}
motors:
  - {joints: "*_leg", kp: 60, kd: 2, torque: 20}
  - {joints: "*_wheel", follows: velocity, kd: 1.0, torque: 2}
"""
CARD = """\
nw-policy: 1
name: driver
robot: cart
adapter: zero
control:
  action: {"*": joint_position_offset, "*_wheel": joint_velocity}
  scale: {"*_leg": 0.25, "*_wheel": 5.0}
observations:
  obs:
    sensor: proprio
    terms: [joint_pos, joint_vel]
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
WHEELS = (1, 3, 5, 7)


def written(folder, mjcf=MJCF, yaml=YAML):
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cart.xml").write_text(mjcf)
    (folder / "robot.yaml").write_text(yaml)
    wheel = trimesh.creation.cylinder(0.08, 0.04, sections=12)
    wheel.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    wheel.export(folder / "wheel.stl")
    return folder


@pytest.fixture
def cart(tmp_path):
    return find_robot(f"{written(tmp_path / 'cart')}/").spec


def card_of(folder, text=CARD):
    (folder / "policy.yaml").write_text(text)
    return load_card(folder / "policy.yaml")


def world_of(card, robot, **options):
    setup = TrialSetup.of(None, robot, card)
    return World(robot, FLAT, actuators=setup.motors, **options)


def test_wheels_follow_velocities_and_stand_at_zero(cart):
    assert [cart.follows[i] for i in WHEELS] == ["velocity"] * 4
    assert cart.follows[0] == "position"
    assert cart.joint_damping == (2.0, 1.0) * 4
    assert cart.feet == ("fr_wheel", "fl_wheel", "rr_wheel", "rl_wheel")
    with World(cart, FLAT) as world:
        for _ in range(100):
            world.step(cart.standing_targets)
        assert world.uprightness > 0.99
        assert np.abs(world.joint_velocities).max() < 0.05
        assert np.linalg.norm(world.trunk_position[:2]) < 0.02


def test_a_wheel_gives_its_gain_times_the_missing_velocity_within_its_torque(cart):
    with World(cart, FLAT) as world:
        targets = np.array(cart.standing_targets)
        targets[1] = 0.5
        world.step(targets)
        missing = 0.5 - world.joint_velocities[1]
        assert world.torques[1] == pytest.approx(1.0 * missing, abs=1e-6)
        targets[1] = 500.0
        world.step(targets)
        assert world.torques[1] == pytest.approx(2.0)


def test_a_light_wheel_with_a_stiff_gain_does_not_swing_up(tmp_path):
    stiff = YAML.replace("kd: 1.0, torque: 2}", "kd: 20.0, torque: 200}")
    robot = find_robot(f"{written(tmp_path / 'cart', yaml=stiff)}/").spec
    with World(robot, FLAT) as world:
        targets = np.where(np.array(robot.follows) == "velocity", 5.0, 0.0)
        rates = []
        for _ in range(50):
            world.step(targets)
            rates.append(world.joint_velocities[list(WHEELS)])
        np.testing.assert_allclose(rates[-1], 5.0, atol=0.2)


def test_a_wheel_that_is_a_mesh_rolls_as_a_cylinder_about_its_axle(cart):
    model = mujoco.MjModel.from_xml_string(cart.mjcf)
    for name in cart.feet:
        (geom,) = np.flatnonzero(model.geom_bodyid == model.body(name).id)
        assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
        np.testing.assert_allclose(model.geom_size[geom, :2], [0.08, 0.02], atol=1e-6)
        axle = np.empty(9)
        mujoco.mju_quat2Mat(axle, model.geom_quat[geom])
        np.testing.assert_allclose(np.abs(axle.reshape(3, 3)[:, 2]), [0, 1, 0], atol=1e-6)


def test_a_velocity_motor_of_the_model_needs_no_line(tmp_path):
    mjcf = MJCF.replace(
        "</worldbody>",
        "</worldbody><actuator>"
        + "".join(
            f'<position joint="{c}_leg" kp="60" forcerange="-9 9"/>'
            f'<velocity joint="{c}_wheel" kv="3" forcerange="-4 4"/>'
            for c in CORNERS
        )
        + "</actuator>",
    )
    yaml = "nw-robot: 1\nname: cart\nmodel: {file: cart.xml}\n"
    spec = find_robot(f"{written(tmp_path, mjcf, yaml)}/").spec
    assert spec.follows == ("position", "velocity") * 4
    assert spec.joint_damping == (0.1, 3.0) * 4
    assert spec.torque_limits == (9.0, 4.0) * 4


def test_a_wheel_without_a_gain_is_told(tmp_path):
    yaml = YAML.replace("kd: 1.0, ", "")
    with pytest.raises(RobotError, match="nothing says the kd of fr_wheel, fl_wheel"):
        find_robot(f"{written(tmp_path, yaml=yaml)}/")


def test_a_card_says_by_group_of_joints_what_actions_mean(tmp_path, cart):
    card = card_of(tmp_path)
    assert motors_follow(card, cart) == cart.follows
    assert actuator_values(card, cart) is None  # They are the robot's own.
    control = JointControl.from_card(card, cart)
    np.testing.assert_allclose(control.targets(np.ones(8)), [0.25, 5.0] * 4)
    with world_of(card, cart) as world:
        for _ in range(100):
            world.step(control.targets(np.array([0.0, 1.0] * 4)))
        # 5 rad/s on wheels of 0.08 m radius.
        assert world.trunk_linear_velocity[0] == pytest.approx(0.4, abs=0.03)


def test_positions_of_wheels_are_left_out_or_zero(tmp_path, cart):
    terms = """    terms:
      - {term: joint_pos, leave_out: ["*_wheel"]}
      - {term: joint_pos, zero: [wheel]}
      - {term: joint_vel, leave_out: ["*_leg"]}
"""
    card = card_of(tmp_path, CARD.replace("    terms: [joint_pos, joint_vel]\n", terms))
    with world_of(card, cart) as world:
        for _ in range(20):
            world.step(np.array([0.0, 5.0] * 4))
        (sensor,) = build_sensors(card, world).values()
        sensor.reset(0)
        seen = sensor.read(moment_of(world))
        legs, wheels = world.joint_positions[0::2], world.joint_positions[1::2]
        assert np.abs(wheels).min() > 0.1
        np.testing.assert_allclose(seen[:4], legs, rtol=1e-5)
        np.testing.assert_allclose(seen[4:12], np.stack([legs, 0 * wheels], 1).ravel(), rtol=1e-5)
        np.testing.assert_allclose(seen[12:], world.joint_velocities[1::2], rtol=1e-5)


@pytest.mark.usefixtures("cart")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"*_wheel": joint_v', '"*_weel": joint_v', "'*_weel' names no joint"),
        ('"*": joint_position_offset, ', "", "no value for fr_leg, fl_leg, rr_leg, rl_leg"),
        ("joint_velocity}", "joint_speed}", "'joint_speed' is not one of them"),
    ],
)
def test_a_group_that_means_nothing_is_refused_with_its_place(tmp_path, old, new, said):
    with pytest.raises(PolicyError) as caught:
        card_of(tmp_path, CARD.replace(old, new))
    assert said in str(caught.value)
    assert "policy.yaml:6" in str(caught.value)


def test_positions_for_a_wheel_without_a_gain_are_refused(tmp_path, cart):
    card = card_of(
        tmp_path,
        CARD.replace('{"*": joint_position_offset, "*_wheel": joint_velocity}', "joint_position"),
    )
    with pytest.raises(PolicyError, match=r"fr_wheel, .* cannot follow a position: kp is 0"):
        actuator_values(card, cart)


@pytest.mark.usefixtures("cart")
def test_lists_of_joints_that_are_not_given_change_no_digest_of_a_card(tmp_path):
    terms = card_of(tmp_path).observations["obs"].model_dump()["terms"]
    assert not {"leave_out", "zero"} & {key for term in terms for key in term}


EXAMPLES = Path(__file__).resolve().parents[3]


def test_the_example_of_a_robot_on_wheels_and_its_card_fit_each_other(tmp_path):
    # The model is not shipped; the names of its joints and bodies are what both files know of it.
    legs = "".join(
        f"""<body name="{leg}_hip" pos="{x} {y} 0">
          <joint name="{leg}_hip_joint" axis="1 0 0" range="-1 1"/><geom size="0.03" mass="0.7"/>
          <body name="{leg}_thigh" pos="0 {y / 3} 0">
            <joint name="{leg}_thigh_joint" axis="0 1 0" range="-1.5 3.4"/>
            <geom size="0.03" mass="1"/>
            <body name="{leg}_calf" pos="0 0 -0.213">
              <joint name="{leg}_calf_joint" axis="0 1 0" range="-2.7 -0.8"/>
              <geom size="0.03" mass="0.2"/>
              <body name="{leg}_wheel_link" pos="0 0 -0.2264">
                <joint name="{leg}_wheel_joint" axis="0 1 0"/>
                <geom type="cylinder" size="0.085 0.03" euler="90 0 0" mass="1"/>
              </body></body></body></body>"""
        for leg, x, y in (
            ("FR", 0.2, -0.1),
            ("FL", 0.2, 0.1),
            ("RR", -0.2, -0.1),
            ("RL", -0.2, 0.1),
        )
    )
    (tmp_path / "go2w.xml").write_text(
        '<mujoco><compiler autolimits="true"/><worldbody><body name="base_link"><freejoint/>'
        f'<geom type="box" size="0.2 0.1 0.05" mass="7"/><site name="imu"/>{legs}'
        "</body></worldbody></mujoco>".replace('angle="degree"', "")
    )
    text = (EXAMPLES / "robots/examples/go2w/robot.yaml").read_text("utf-8")
    (tmp_path / "robot.yaml").write_text(text)
    model = (tmp_path / "go2w.xml").read_text().replace("<compiler ", '<compiler angle="radian" ')
    (tmp_path / "go2w.xml").write_text(model.replace('euler="90', 'euler="1.5708'))
    robot = find_robot(f"{tmp_path}/").spec
    assert robot.follows.count("velocity") == 4
    card = load_card(EXAMPLES / "policies/examples/go2w-robot-lab/policy.yaml")
    (observation,) = check_card(card)
    assert observation.shape == (57,)
    follows = dict(zip(robot.joints, motors_follow(card, robot), strict=True))
    assert {name for name, told in follows.items() if told == "velocity"} == {
        name for name in robot.joints if "wheel" in name
    }


def drafted(tmp_path, mjcf):
    from nw_eval import api

    folder = written(tmp_path / "cart", mjcf)
    (folder / "robot.yaml").unlink()
    return api.init_robot(folder / "cart.xml").text


def test_a_draft_takes_what_is_round_low_and_turns_without_end_for_a_wheel(tmp_path):
    text = drafted(tmp_path, MJCF)
    (line,) = [line for line in text.splitlines() if "follows: velocity" in line]
    assert '"*_wheel"' in line
    assert "a wheel, by its shape and range" in line.partition("CHECK")[2]


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ('axis="0 1 0"/>', 'axis="0 1 0" range="-90 90"/>'),  # It does not turn without end.
        ('type="mesh" mesh="wheel"', 'type="box" size="0.1 0.02 0.1"'),  # It is not round.
        ('<joint name="{0}_wheel" axis="0 1 0"/>', '<joint name="{0}_wheel" axis="0 0 1"/>'),
    ],
)
def test_a_draft_takes_nothing_else_for_a_wheel(tmp_path, was, now):
    mjcf = MJCF
    for name in CORNERS:
        mjcf = mjcf.replace(was.format(name), now.format(name))
    assert mjcf != MJCF
    assert "follows: velocity" not in drafted(tmp_path, mjcf)
