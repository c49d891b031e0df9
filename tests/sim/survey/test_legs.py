"""What a scene asks of legs, and how a robot stands that nobody balances."""

import numpy as np
import pytest

from nw_eval.api import list_scenes
from nw_scenes.mesh import merge
from nw_scenes.robots import find_robot, get_robot
from nw_scenes.scene import Box, Scene
from nw_sim.catalogue import get_scene
from nw_sim.survey.course import stance_of
from nw_sim.survey.legs import demands_of, fit_of, legs_of

# Two legs with a hip, a knee and a foot; without a policy it tips over.
LEG = """
      <body name="{0}_thigh" pos="0 {1} -0.05">
        <joint name="{0}_hip" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
        <body name="{0}_shin" pos="0 0 -0.2">
          <joint name="{0}_knee" axis="0 1 0" range="0 120"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" mass="0.3"/>
          <geom type="box" pos="0.02 0 -0.19" size="0.05 0.03 0.01" mass="0.1"/>
        </body>
      </body>"""
BIPED = f"""
<mujoco>
  <worldbody>
    <body name="pelvis" pos="0 0 0.6">
      <freejoint/>
      <geom type="box" pos="0.04 0 0.1" size="0.05 0.1 0.1" mass="5"/>
      {LEG.format("l", 0.08)}{LEG.format("r", -0.08)}
    </body>
  </worldbody>
</mujoco>
"""
YAML = """\
nw-robot: 1
name: biped
model: {file: biped.xml}
motors: [{joints: "*", kp: 60, kd: 2, torque: 30}]
"""


@pytest.fixture
def biped(tmp_path):
    folder = tmp_path / "biped"
    folder.mkdir()
    (folder / "biped.xml").write_text(BIPED)
    (folder / "robot.yaml").write_text(YAML)
    return find_robot(f"{folder}/").spec


def place(*boxes, task="hurdles", trail=((3.0, 0.0, 0.0),)):
    return Scene(
        name="tests/place",
        task=task,
        title="",
        solids=boxes,
        trail=np.array(trail),
        static_mesh=merge([]),
        splat=None,
    )


def box(x, z, size):
    return Box(center=(x, 0.0, z), half_size=size)


def test_a_biped_that_tips_over_stands_as_it_was_put_down(biped):
    stance = stance_of(biped)
    up = stance.T_ground_camera[:3, 1]
    np.testing.assert_allclose(up, [0, 0, -1], atol=0.05)
    # Soles are 0.44 m under the pelvis, and 0.1 m long, from 0.03 m behind the ankle.
    assert stance.height == pytest.approx(0.45, abs=0.012)
    assert stance.fore - stance.hind > 0.05
    assert stance.half_width == pytest.approx(0.11, abs=0.01)


def test_robots_that_stand_have_the_stance_that_they_had():
    stance = stance_of(get_robot("go1"))
    assert stance.fore == pytest.approx(0.211283934, abs=1e-8)
    assert stance.hind == pytest.approx(-0.237553266, abs=1e-8)


def test_a_leg_reaches_from_its_first_joint_to_the_sole(biped):
    assert legs_of(biped).length == pytest.approx(np.hypot(0.02, 0.39) + 0.01, abs=0.01)
    # Hip to thigh 0.08 m aside, 0.213 m each to knee and foot, a knee that never straightens.
    bent = np.pi - 0.916298
    chain = np.sqrt(2 * 0.213**2 * (1 - np.cos(bent)))
    assert legs_of(get_robot("go1")).length == pytest.approx(np.hypot(0.08, chain) + 0.02, abs=0.01)


def test_the_highest_step_is_measured_and_a_ramp_or_a_slit_is_none():
    treads = [box(1.0 + 0.41 * k, 0.05 * (k + 1), (0.2, 1.0, 0.05 * (k + 1))) for k in range(3)]
    asked = demands_of(place(*treads), height=0.3)
    assert asked.up == pytest.approx(0.1, abs=1e-6)
    assert asked.down == pytest.approx(0.3, abs=1e-6)
    assert asked.gap == 0.0
    ramp = Box(
        center=(1.5, 0.0, 0.0),
        half_size=(0.6, 1.0, 0.01),
        quat=(np.cos(0.25), 0.0, -np.sin(0.25), 0.0),
    )
    assert demands_of(place(ramp), height=0.3).up < 0.05


def test_a_gap_is_as_long_as_from_rim_to_rim_and_a_drop_at_the_end_is_a_step():
    blocks = [box(0.5, 0.3, (0.5, 1.0, 0.3)), box(2.0, 0.3, (0.5, 1.0, 0.3))]
    asked = demands_of(place(*blocks, task="gaps", trail=((2.0, 0.0, 0.6), (3, 0, 0))), height=0.3)
    assert asked.gap == pytest.approx(0.5, abs=0.03)
    assert asked.depth == pytest.approx(0.6, abs=1e-6)
    assert asked.down == pytest.approx(0.6, abs=1e-6)


def test_walls_leave_as_much_room_as_there_is_between_them():
    walls = [Box(center=(1.5, side * 0.4, 0.5), half_size=(0.5, 0.1, 0.5)) for side in (-1.0, 1.0)]
    assert demands_of(place(*walls), height=0.3).room == pytest.approx(0.6, abs=1e-6)
    assert demands_of(place(), height=0.3).room == np.inf


def test_what_no_leg_of_its_length_could_do_is_said(biped):
    legs = legs_of(biped)
    low, high = place(box(1.5, 0.1, (0.2, 1, 0.1))), place(box(1.5, 0.3, (0.2, 1, 0.3)))
    assert fit_of(low, legs).asks_for == "walking"
    assert fit_of(high, legs).beyond == ("a step of 0.60 m up", "a step of 0.60 m down")
    assert fit_of(place(box(1.5, 0.15, (0.2, 1, 0.15))), legs).asks_for == "climbing"
    narrow = [Box(center=(1.5, s * 0.2, 0.5), half_size=(0.5, 0.1, 0.5)) for s in (-1, 1)]
    assert fit_of(place(*narrow), legs).beyond == ("0.20 m between walls for a width of 0.22 m",)


@pytest.mark.parametrize(
    ("scene", "step", "gap"),
    [
        ("stairs/six_wood_hall", 0.17, 0.0),
        ("hurdles/three_high_wood_hall", 0.36, 0.0),
        ("gaps/three_20in_lobby", 0.0, 0.51),
    ],
)
def test_built_in_scenes_ask_what_their_titles_say(scene, step, gap):
    asked = demands_of(get_scene(scene), height=0.3)
    assert max(asked.up, asked.down) == pytest.approx(step, abs=0.005)
    assert asked.gap == pytest.approx(gap, abs=0.03)


def test_the_built_in_robots_could_do_every_built_in_scene():
    for scene in list_scenes(("hurdles/*", "gaps/*"), robot="go1"):
        assert scene.fit is not None
        assert not scene.fit.beyond, scene.name
