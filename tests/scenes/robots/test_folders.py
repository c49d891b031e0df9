"""A robot of one's own: a folder with a model file, and robot.yaml for what that does not say."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from nw_base.errors import RobotError, UsageError
from nw_base.plugins import installed
from nw_base.words import ROBOTS
from nw_eval import api
from nw_eval.suite import load_suite
from nw_scenes.mesh import merge
from nw_scenes.robots import BUILT_IN, find_robot, get_robot, know_robot, robot_names
from nw_scenes.robots import folder as limits
from nw_scenes.scene import HeightField, Scene
from nw_sim.physics import World
from nw_sim.tasks import Limits

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))

MJCF = """
<mujoco model="hopper">
  <compiler angle="degree" meshdir="shapes"/>
  <option timestep="0.1" gravity="0 0 0"/>
  <default>
    <geom friction="0.1 0 0" condim="1" rgba="1 0 0 1"/>
    <default class="servo"><position kp="70" forcerange="-9 9"/></default>
  </default>
  <asset>
    <texture name="t" type="2d" file="../../looks.png"/>
    <material name="red" rgba="0.9 0.1 0.2 1"/>
    <mesh name="shell" file="shell.stl" scale="0.1 0.1 0.1"/>
    <mesh name="unused" file="nowhere.stl"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="9 9 1"/>
    <body name="hull" pos="0 0 1">
      <joint name="loose" type="free"/>
      <geom name="hull" type="box" size="0.2 0.1 0.05" mass="5"/>
      <geom type="mesh" mesh="shell" contype="0" conaffinity="0" material="red" mass="0"/>
      <camera name="front" pos="0.2 0 0.05" xyaxes="0 -1 0 0 0 1" fovy="70"/>
      <body name="thigh_l" pos="0 0.1 0">
        <joint name="knee_l" axis="0 1 0" range="-90 90" armature="0.02" damping="0.3"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
        <body name="toe_l" pos="0 0 -0.2">
          <joint name="toe_l" axis="0 1 0" range="-40 40" frictionloss="0.05"/>
          <geom type="sphere" size="0.03" mass="0.2"/>
        </body>
      </body>
      <body name="thigh_r" pos="0 -0.1 0">
        <joint name="knee_r" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
        <body name="toe_r" pos="0 0 -0.2">
          <joint name="toe_r" axis="0 1 0" range="-40 40"/>
          <geom type="sphere" size="0.03" mass="0.2"/>
        </body>
      </body>
      <body name="flag" pos="-0.2 0 0">
        <joint name="wag" axis="0 0 1" damping="0.1"/>
        <geom type="sphere" size="0.01" pos="-0.05 0 0" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="a" joint="knee_l" class="servo"/>
    <motor name="b" joint="knee_r" ctrlrange="-4 4" gear="3"/>
    <motor name="c" joint="toe_l" forcerange="-6 7"/>
    <motor name="d" joint="toe_r"/>
  </actuator>
  <sensor><gyro site="imu"/></sensor>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.4 -0.1 0.4 -0.1 0"/></keyframe>
</mujoco>
"""
YAML = """\
nw-robot: 1
name: hopper
model: {file: hopper.xml}
motors:
  - {joints: "*", kp: 40, kd: 1.5}
  - {joints: "toe_*", kp: 20, torque: 5, armature: 0.07, friction: 0.4}
  - {joints: knee_l, kp: 80}
"""
FLAT = Scene(
    name="tests/flat",
    task="hurdles",
    title="",
    solids=(),
    trail=np.array([[1.0, 0.0, 0.0]]),
    static_mesh=merge([]),
    splat=None,
)


def written(folder, mjcf=MJCF, yaml=YAML):
    """Write a robot's folder with a mesh that a geom shows."""
    (folder / "shapes").mkdir(parents=True, exist_ok=True)
    (folder / "hopper.xml").write_text(mjcf)
    (folder / "robot.yaml").write_text(yaml)
    trimesh.creation.box((2.0, 1.0, 0.5)).export(folder / "shapes" / "shell.stl")
    return folder


def faults(folder, mjcf=MJCF, yaml=YAML):
    """Return what is wrong with a robot, without where the test put it."""
    with pytest.raises(RobotError) as caught:
        find_robot(f"{written(folder, mjcf, yaml)}/")
    return str(caught.value).replace(f"{folder}/", "")


@pytest.fixture
def hopper(tmp_path):
    return find_robot(f"{written(tmp_path / 'hopper')}/").spec


def test_what_the_model_says_is_derived_and_robot_yaml_overrides_it_by_patterns(hopper):
    assert hopper.joints == ("knee_l", "toe_l", "knee_r", "toe_r")  # `wag` has no motor
    assert hopper.kp == (80.0, 20.0, 40.0, 20.0)
    assert hopper.joint_damping == (1.5,) * 4
    assert hopper.torque_limits == (9.0, 5.0, 12.0, 5.0)
    assert hopper.armature == (0.02, 0.07, 0.0, 0.07)
    assert hopper.friction_loss == (0.0, 0.4, 0.0, 0.4)
    assert hopper.default_pose == (0.4, -0.1, 0.4, -0.1)
    np.testing.assert_allclose(hopper.joint_ranges[0], (-np.pi / 2, np.pi / 2))
    assert (hopper.root, hopper.root_joint) == ("hull", "loose")
    assert hopper.bodies == ("hull", "thigh_l", "toe_l", "thigh_r", "toe_r", "flag")
    assert (hopper.touches, hopper.feet, hopper.monitored) == (
        "body",
        ("toe_l", "toe_r"),
        ("hull",),
    )
    assert Limits.of(hopper).monitored_force == pytest.approx(0.08 * 9.806 * 6.45)
    # A leg of 0.2 m at 0.4 rad, its ball, and a centimetre of air.
    assert hopper.spawn_height == pytest.approx(0.2 * np.cos(0.4) + 0.03 + 0.01)


def test_its_own_camera_is_its_eye(hopper):
    eye = hopper.cameras["ego"]
    assert eye.position == pytest.approx((0.2, 0.0, 0.05))
    np.testing.assert_allclose(eye.R_trunk_camera, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    assert eye.fovy == pytest.approx(np.radians(70.0))


def test_cameras_have_names_and_look_where_a_rotation_or_a_pitch_says(tmp_path):
    yaml = YAML + (
        "cameras:\n"
        "  back: {position: [-0.2, 0, 0.1], fovy: 60,\n"
        "    rotation: [[0, 0, -1], [1, 0, 0], [0, -1, 0]]}\n"
        "  down: {position: [0.1, 0, 0], pitch: 1.5707963267948966}\n"
    )
    cameras = find_robot(f"{written(tmp_path, MJCF, yaml)}/").spec.cameras
    assert list(cameras) == ["ego", "front", "back", "down"]
    assert cameras["back"].fovy == pytest.approx(np.pi / 3)
    ahead = {name: np.array(mount.R_trunk_camera)[:, 2] for name, mount in cameras.items()}
    np.testing.assert_allclose(ahead["ego"], (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(ahead["back"], (-1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(ahead["down"], (0, 0, -1), atol=1e-12)


def test_feet_and_watched_parts_may_be_geoms_and_a_force_may_be_newtons(tmp_path):
    mjcf = MJCF.replace('type="sphere" size="0.03"', 'name="ball_{}" type="sphere" size="0.03"')
    mjcf = mjcf.replace("ball_{}", "ball_l", 1).replace("ball_{}", "ball_r")
    yaml = YAML + (
        "touches: geom\nfeet: [ball_r, ball_l]\ncollided: {newtons: 12.5}\n"
        "published: {body: [ball_l], free_joint: {damping: 0.3}, height_camera: [0, 0, 25.03]}\n"
    )
    spec = find_robot(f"{written(tmp_path, mjcf, yaml)}/").spec
    assert (spec.touches, spec.feet, spec.monitored) == ("geom", ("ball_r", "ball_l"), ("hull",))
    assert spec.published_monitored == ("ball_l",)
    assert spec.root_defaults == (0.3, 0.0, 0.0)
    assert spec.height_camera_offset == (0.0, 0.0, 25.03)
    assert Limits.of(spec).monitored_force == 12.5
    with World(spec, FLAT) as world:
        for _ in range(8):
            world.step(spec.default_pose)
        assert world.foot_contacts.all()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("", "", "the world holds other than one body"),
        ('<geom name="floor" type="plane" size="9 9 1"/>', "", "its actuators are other than one"),
    ],
)
def test_a_model_is_as_it_is_written_only_where_that_is_a_robot(tmp_path, old, new, said):
    yaml = YAML.replace("hopper.xml}", "hopper.xml, as_written: true}")
    message = faults(tmp_path, MJCF.replace(old, new), yaml)
    assert message == (f"robot.yaml:3:27: model.as_written: {said}{message.partition(said)[2]}")
    assert message.endswith("leave as_written out, and the file is rewritten")


def test_a_servo_and_a_motor_without_words_keep_what_the_model_says(tmp_path):
    yaml = YAML[: YAML.index("motors:")] + "motors: [{joints: '?*_r', kp: 1, torque: 2}]\n"
    mended = MJCF.replace('joint="toe_l"', 'joint="toe_l" gear="2"')
    message = faults(tmp_path, mended, yaml)
    assert message == (
        "robot.yaml:4:1: motors: nothing says the kp of toe_l; "
        'add `- {joints: "*", kp: ...}` with its N m / rad'
    )
    spec = find_robot(f"{written(tmp_path, mended, yaml.replace('?*_r', '*[er]_[lr]'))}/").spec
    assert spec.kp == (1.0, 1.0, 1.0, 1.0)
    assert spec.joint_damping[0] == 0.3


def test_what_collides_is_left_to_physics_and_no_mesh_that_is_only_seen(hopper):
    model = mujoco.MjModel.from_xml_string(hopper.mjcf)
    assert model.nmesh == 0
    assert (model.geom_contype == 1).all()
    assert [model.actuator(i).name for i in range(model.nu)] == list(hopper.joints)


def test_defaults_and_options_of_its_file_change_no_scene(hopper):
    with World(hopper, FLAT) as world:
        model = world._model
        assert model.opt.timestep == 0.005
        assert model.opt.gravity[2] == -9.806
        ground = model.geom("ground")
        assert ground.condim == 3
        np.testing.assert_array_equal(ground.friction, FLAT.ground.friction)
        assert "floor" not in {model.geom(i).name for i in range(model.ngeom)}
        assert model.geom("hull").condim == 1


def test_a_model_may_include_files_of_its_folder_which_count_for_its_identity(tmp_path):
    whole = find_robot(f"{written(tmp_path / 'whole')}/")
    first, second = MJCF.index("<worldbody>"), MJCF.index("<actuator>")
    parts = MJCF[:first] + '<include file="parts/body.xml"/>' + MJCF[second:]
    folder = written(tmp_path / "split", parts)
    (folder / "parts").mkdir()
    inner = f"<mujocoinclude>{MJCF[first:second]}</mujocoinclude>"
    (folder / "parts" / "body.xml").write_text(inner)
    split = find_robot(f"{folder}/")
    assert split.spec == whole.spec
    (folder / "parts" / "body.xml").write_text(inner.replace('mass="5"', 'mass="6"'))
    assert find_robot(f"{folder}/").identity != split.identity
    many = "<site/>" * (limits.ELEMENTS // 2)
    (folder / "parts" / "body.xml").write_text(inner.replace("<light", f"{many}<light"))
    message = faults(
        folder, parts.replace("<actuator>", f"<worldbody>{many}</worldbody><actuator>")
    )
    assert message == ("parts/body.xml:1:1: it has over 20000 elements, or 100 in each other")


def test_damping_of_a_servo_is_its_kd_as_dampratio_says_it_too(tmp_path):
    mjcf = MJCF.replace('kp="70"', 'kp="70" kv="1.1"')
    yaml = YAML[: YAML.index("motors:")] + "motors: [{joints: '*', kp: 1, torque: 2}]\n"
    kd = find_robot(f"{written(tmp_path / 'kv', mjcf, yaml)}/").spec.joint_damping
    assert kd == pytest.approx((0.3 + 1.1, 0.0, 0.0, 0.0))
    mjcf = MJCF.replace('kp="70"', 'kp="70" dampratio="1"')
    kd = find_robot(f"{written(tmp_path / 'ratio', mjcf, yaml)}/").spec.joint_damping
    theirs = mujoco.MjModel.from_xml_string(
        mjcf.replace('file="../../looks.png"', 'builtin="flat" width="1" height="1"')
        .replace('<mesh name="unused" file="nowhere.stl"/>', "")
        .replace('site="imu"', 'site="s"')
        .replace('<camera name="front"', '<site name="s"/><camera name="front"'),
        {"shapes/shell.stl": (tmp_path / "kv" / "shapes" / "shell.stl").read_bytes()},
    )
    assert kd[0] == pytest.approx(0.3 - theirs.actuator_biasprm[0, 2])
    assert kd[0] > 0.35


def test_an_inertia_in_full_and_a_flat_mesh_that_is_only_seen_are_read(tmp_path):
    full = '<inertial pos="0 0 0" mass="5" fullinertia="0.02 0.03 0.04 0.001 0 0"/>'
    mjcf = MJCF.replace('<geom name="hull"', f'{full}<geom name="hull"')
    flat = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n"
    mjcf = mjcf.replace('file="shell.stl"', 'file="plate.obj" inertia="shell"')
    folder = written(tmp_path, mjcf)
    (folder / "shapes" / "plate.obj").write_text(flat)
    spec = find_robot(f"{folder}/").spec
    model = mujoco.MjModel.from_xml_string(spec.mjcf)
    assert sorted(model.body("hull").inertia) == pytest.approx(
        sorted(np.linalg.eigvalsh([[0.02, 0.001, 0], [0.001, 0.03, 0], [0, 0, 0.04]])), rel=1e-5
    )
    assert [shape.kind for shape in spec.visuals if shape.body == "hull"][:1] == ["mesh"]


def test_the_only_keyframe_is_the_pose_whatever_it_is_called(tmp_path):
    other = MJCF.replace('name="home"', 'name="standing"')
    spec = find_robot(f"{written(tmp_path / 'one', other)}/").spec
    assert spec.default_pose == (0.4, -0.1, 0.4, -0.1)
    two = other.replace("<keyframe>", '<keyframe><key name="lying"/>')
    spec = find_robot(f"{written(tmp_path / 'two', two)}/").spec
    assert spec.default_pose == (0.0,) * 4


def test_it_stands_on_its_feet(hopper):
    with World(hopper, FLAT) as world:
        for _ in range(8):
            world.step(hopper.default_pose)
        assert world.foot_contacts.all()
        assert world.monitored_force() == 0.0


def test_a_urdf_gets_a_free_joint(tmp_path):
    urdf = """
    <robot name="stick">
      <link name="base"><inertial><mass value="3"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
        <visual><geometry><mesh filename="package://stick/none.dae"/></geometry></visual>
        <collision><geometry><mesh filename="package://stick/shapes/shell.stl" scale="0.1 0.1 0.1"/>
        </geometry></collision></link>
      <link name="foot"><inertial><mass value="1"/>
        <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
        <collision><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.04"/></geometry></collision>
      </link>
      <joint name="hip" type="revolute"><parent link="base"/><child link="foot"/>
        <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="33" velocity="5"/></joint>
      <transmission name="t"/>
    </robot>
    """
    yaml = "nw-robot: 1\nname: stick\nmodel: {file: hopper.xml}\nmotors: [{joints: '*', kp: 9}]\n"
    spec = find_robot(f"{written(tmp_path, urdf, yaml)}/").spec
    assert (spec.joints, spec.torque_limits) == (("hip",), (33.0,))
    assert (spec.root, spec.feet) == ("base", ("foot",))
    assert spec.spawn_height == pytest.approx(0.35)
    with World(spec, FLAT) as world:
        world.step(spec.default_pose)
        assert world.trunk_position[2] == pytest.approx(0.35, abs=0.01)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("feet: [toe_l, toe_x]", "robot.yaml:4:15: feet: no body 'toe_x'; did you mean 'toe_"),
        ("feet: [flag]", None),
        ("body: [hul]", "robot.yaml:4:8: body: no body 'hul'; did you mean 'hull'?"),
        ("root: toe_l", "robot.yaml:4:1: root: the free joint is that of 'hull'"),
        ("pose: hom", "robot.yaml:4:1: pose: no keyframe 'hom'; did you mean 'home'?"),
        ("pose: {'knee_*': 2.0}", "robot.yaml:4:1: pose: 2 is beyond the range of knee_l; give"),
        ("pose: {'kne_l': 0.1}", "robot.yaml:4:8: pose: no joint is named 'kne_l'; did you mean"),
        (
            "eye: {body: toe, position: [0, 0, 0]}",
            "robot.yaml:4:7: eye.body: no body 'toe'; did you mean",
        ),
        ("touches: geom", "robot.yaml:4:1: touches: geom; name the geoms of `feet`"),
        (
            "touches: geom\nfeet: [hull, toe]",
            "robot.yaml:5:14: feet: no geom that collides 'toe'; ",
        ),
        ("published: {body: [hul]}", "robot.yaml:4:20: published.body: no body 'hul'; did you"),
        (
            "cameras: {a: {position: [0, 0, 0], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}}",
            "robot.yaml:4:36: cameras.a.rotation: it is not a rotation",
        ),
        ("feets: [toe_l]", "robot.yaml:4:1: unknown key 'feets'; did you mean 'feet'?"),
        ("fell: {tilt: -1}", "robot.yaml:4:8: fell.tilt"),
        ("root: .nan", "robot.yaml:4:1: root"),
    ],
)
def test_what_robot_yaml_says_wrongly_is_reported_with_its_place(tmp_path, line, said):
    yaml = YAML.replace("motors:", f"{line}\nmotors:")
    if said is None:
        assert find_robot(f"{written(tmp_path, MJCF, yaml)}/").spec.feet == ("flag",)
    else:
        assert faults(tmp_path, MJCF, yaml).startswith(said)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<light", '<include file="/etc/passwd"/><light', "<include>: '/etc/passwd' leaves the"),
        ("<light", '<include file="../a.xml"/><light', "<include>: '../a.xml' leaves the folder"),
        ("<light", '<include file="a.xml"/><light', "<include>: 'a.xml' is not in the folder"),
        ("<light", '<include file="./hopper.xml"/><light', "'hopper.xml' is read already; inc"),
        ("<asset>", '<extension><plugin plugin="x"/></extension><asset>', "<extension> is not"),
        ("<asset>", '<asset><model name="m" file="m.xml"/>', "<model> is not among the elements"),
        ('<geom name="hull"', '<geom type="hfield" hfield="h"/><geom name="hull"', "height field"),
        ("shell.stl", "../../shell.stl", "leaves the folder"),
        ("shell.stl", "/etc/passwd", "leaves the folder"),
        ("shell.stl", "gone.stl", "hopper.xml:12:1: mesh 'shapes/gone.stl' is not in"),
        ("shell.stl", "shell.dae", "mesh 'shapes/shell.dae' is not in the folder"),
        ("<mujoco model", "<!DOCTYPE x><mujoco model", "declares a document type or entities"),
        ("</mujoco>", "", "is not XML"),
        (
            "\n<mujoco model",
            '<?xml version="1.0" encoding="utf-7"?><mujoco model',
            "write it in UTF-8",
        ),
        ('mass="5"', 'mass="nan"', "<geom> has mass='nan'; write numbers"),
        ('mass="5"', 'mass="NaN(1)"', "<geom> has mass='NaN(1)'; write numbers"),
        ('mass="5"', 'mass="1e300"', "<geom> has mass='1e300': a number over 1e+20; write"),
        ('size="0.03" mass="0.2"', 'size="1e5" mass="0.2"', "over 10000; lengths are in m"),
        ('pos="0 0.1 0"', 'pos="0 -inf 0"', "<body> has pos='0 -inf 0'"),
        ('type="free"', 'type="ball"', "has joints that are not free"),
        (
            '<joint name="toe_l" axis',
            '<joint name="toe_l" type="slide" axis',
            "'toe_l' is not a hinge",
        ),
        ('mass="5"', 'mass="-5"', "MuJoCo cannot"),
        ('size="0.03" mass="0.2"', 'size="nan" mass="0.2"', "<geom> has size='nan'"),
    ],
)
def test_a_model_that_reaches_out_of_its_folder_or_is_none_is_refused(tmp_path, old, new, said):
    assert old in MJCF
    message = faults(tmp_path, MJCF.replace(old, new))
    assert said in message
    assert message.startswith(("hopper.xml:", "robot.yaml:"))


def test_what_is_too_much_is_refused_before_it_is_compiled(tmp_path, monkeypatch):
    many = "<site/>" * (limits.ELEMENTS + 1)
    assert "over 20000 elements" in faults(tmp_path, MJCF.replace("<light", f"{many}<light"))
    deep = "<body>" * limits.DEPTH + "</body>" * limits.DEPTH
    assert "over 20000 elements, or 100" in faults(
        tmp_path, MJCF.replace("<light", f"{deep}<light")
    )
    long = f"<!--{'x' * limits.XML_BYTES}-->"
    assert "over 4" in faults(tmp_path, MJCF + long)
    monkeypatch.setattr(limits, "FACES", 11)
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))  # Other tests kept this robot.
    assert "mesh 'shapes/shell.stl' has over 11 faces" in faults(tmp_path)


def test_a_damaged_mesh_gives_no_traceback(tmp_path):
    folder = written(tmp_path)
    (folder / "shapes" / "shell.stl").write_bytes(b"solid x\nfacet normal 1 2")
    with pytest.raises(RobotError, match="mesh 'shapes/shell"):
        find_robot(f"{folder}/")


def test_a_link_out_of_the_folder_is_not_followed(tmp_path):
    folder = written(tmp_path / "robot")
    outside = tmp_path / "shell.stl"
    shutil.move(folder / "shapes" / "shell.stl", outside)
    (folder / "shapes" / "shell.stl").symlink_to(outside)
    with pytest.raises(RobotError, match="leaves the folder"):
        find_robot(f"{folder}/")


def test_the_model_must_have_the_digest_that_robot_yaml_says(tmp_path):
    yaml = YAML.replace("hopper.xml}", f"hopper.xml, sha256: {'ab' * 32}}}")
    assert faults(tmp_path, MJCF, yaml).startswith(
        "robot.yaml:3:27: model.sha256: that of hopper.xml"
    )


def test_its_identity_is_that_of_all_its_files(tmp_path):
    folder = written(tmp_path / "one")
    first = find_robot(f"{folder}/")
    assert first.reference == f"hopper@{first.identity}"
    assert find_robot(f"{shutil.copytree(folder, tmp_path / 'two')}/").identity == first.identity
    trimesh.creation.box((2.0, 1.0, 0.6)).export(folder / "shapes" / "shell.stl")
    changed = find_robot(f"{folder}/")
    assert changed.identity != first.identity
    (folder / "notes.txt").write_text("not read")
    assert find_robot(f"{folder}/").identity == changed.identity
    know_robot(first.reference, folder)
    with pytest.raises(RobotError, match=f"{changed.identity}, {first.identity} is meant"):
        get_robot(first.reference)


def test_a_folder_is_found_by_name_in_robots_and_a_misspelt_one_is_guessed(tmp_path, monkeypatch):
    written(tmp_path / "robots" / "jumper", MJCF, YAML.replace("name: hopper", "name: jumper"))
    monkeypatch.chdir(tmp_path)
    assert get_robot("jumper").name == "jumper"
    assert {"jumper", *BUILT_IN} <= set(robot_names())
    with pytest.raises(UsageError, match=r"unknown robot 'jumpr'; did you mean 'jumper'\?"):
        get_robot("jumpr")
    with pytest.raises(UsageError, match="unknown robot 'go3'; did you mean"):
        get_robot("go3")


def test_a_built_in_name_is_not_taken(tmp_path):
    message = faults(tmp_path, MJCF, YAML.replace("name: hopper", "name: go1"))
    assert message == "robot.yaml:2:1: name: 'go1' is built in; give another name"
    assert get_robot("go1").kp == (20.0,) * 12
    assert BUILT_IN == ROBOTS


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package with two robots, one made by a function and one that is a folder."""
    written(tmp_path / "strider_files", MJCF, YAML.replace("name: hopper", "name: strider"))
    (tmp_path / "my_robots.py").write_text(
        "from dataclasses import replace\n"
        "from pathlib import Path\n"
        "from nw_scenes.robots import get_robot\n"
        "def tiny():\n    return replace(get_robot('go1'), name='tiny', kp=(7.0,) * 12)\n"
        "def wrong():\n    return get_robot('go1')\n"
        "def broken():\n    raise ValueError('no figures')\n"
        "FOLDER = Path(__file__).parent / 'strider_files'\n"
    )
    info = tmp_path / "my_robots-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-robots\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[nw_eval.robots]\ntiny = my_robots:tiny\nstrider = my_robots:FOLDER\n"
        "wrong = my_robots:wrong\nbroken = my_robots:broken\ngone = no_such_module:x\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    installed.cache_clear()
    yield tmp_path
    installed.cache_clear()
    sys.modules.pop("my_robots", None)


@pytest.mark.usefixtures("package")
def test_an_installed_package_brings_robots_along_with_its_version():
    tiny = find_robot("tiny")
    assert tiny.spec.kp == (7.0,) * 12
    assert tiny.reference.startswith("tiny@my-robots-1.2-")
    strider = find_robot("strider")
    assert strider.spec.joints[0] == "knee_l"
    assert {"tiny", "strider"} <= set(robot_names())
    assert find_robot(strider.reference).identity == strider.identity


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("wrong", "plug-in 'wrong' of my-robots .* is the robot 'go1'; give both the same name"),
        ("broken", "plug-in 'broken' of my-robots .* ValueError: no figures"),
        ("gone", "plug-in 'gone' of my-robots .* ModuleNotFoundError"),
    ],
)
def test_a_package_that_cannot_be_used_is_named(name, said):
    with pytest.raises(RobotError, match=said):
        get_robot(name)


def test_bodies_beside_the_one_with_the_free_joint_are_left_out_with_their_joints(tmp_path):
    alone = find_robot(f"{written(tmp_path / 'alone')}/").spec
    # As files of Unitree's h1 and g1 keep joints that are locked: far above, with a motor.
    spare = (
        '<body name="{0}" pos="0 0 20"><joint name="{0}" range="-9 9"/><geom size="0.1"/></body>'
    )
    mjcf = MJCF.replace("<worldbody>", f"<worldbody>{spare.format('before')}")
    mjcf = mjcf.replace("</worldbody>", f"{spare.format('after')}</worldbody>")
    mjcf = mjcf.replace("<actuator>", '<actuator><motor joint="after" ctrlrange="-5 5"/>')
    mjcf = mjcf.replace('qpos="0 0 1 1', 'qpos="0.7 0 0 1 1').replace(
        '-0.1 0"/></key', '-0.1 0 0.8"/></key'
    )
    spec = find_robot(f"{written(tmp_path / 'beside', mjcf)}/").spec
    assert spec.joints == alone.joints
    assert spec.default_pose == alone.default_pose
    assert spec.mjcf == alone.mjcf


@pytest.mark.assets
@pytest.mark.parametrize(
    ("name", "model", "joints", "feet"),
    [("b2", "b2.xml", 12, 4), ("g1", "g1_12dof.xml", 12, 2)],
)
def test_robots_of_others_are_read_as_they_are(tmp_path, name, model, joints, feet):
    own = ASSETS / "robots" / name
    if not own.is_dir():
        pytest.skip(f"needs {own}")
    shutil.copytree(own, tmp_path / name)
    (tmp_path / name / "robot.yaml").write_text(
        f"nw-robot: 1\nname: {name}\nmodel: {{file: {model}}}\nmotors: [{{joints: '*', kp: 100}}]\n"
    )
    spec = find_robot(f"{tmp_path / name}/").spec
    assert len(spec.joints) == joints
    assert len(spec.feet) == feet
    theirs = mujoco.MjModel.from_xml_path(str(own / model))
    ours = mujoco.MjModel.from_xml_string(spec.mjcf)
    for key in ("body_mass", "body_inertia", "body_pos", "jnt_axis", "jnt_range"):
        np.testing.assert_allclose(
            getattr(ours, key), getattr(theirs, key), rtol=1e-4, atol=1e-9, err_msg=key
        )
    solid = np.flatnonzero(theirs.geom_contype)
    for key in ("geom_pos", "geom_size", "geom_friction", "geom_type"):
        np.testing.assert_allclose(
            getattr(ours, key), getattr(theirs, key)[solid], rtol=1e-4, atol=1e-6
        )
    assert min(spec.torque_limits) >= 50.0


def test_a_suite_of_checked_scenes_names_the_folder_of_their_robot_from_its_own(
    tmp_path, monkeypatch
):
    written(tmp_path / "hopper")
    (tmp_path / "suites").mkdir()
    monkeypatch.chdir(tmp_path)
    for suite in (Path("suites/beside.yaml"), Path("here.yaml")):
        api.check_scenes(["flat/carpet_room"], robot="./hopper", out=suite, policy="stand")
        own = load_suite(suite)
        assert find_robot(own.robot, own.base) == find_robot("./hopper")


def field(height):
    """Return level ground that a scan gave, at a height."""
    return HeightField(
        center=(0.0, 0.0),
        half_size=(2.0, 2.0),
        heights=np.full((41, 41), height, dtype=np.float32),
        floor=-1.0,
    )


@pytest.mark.parametrize("kind", ["mesh", "ellipsoid"])
def test_feet_that_are_meshes_or_ellipsoids_stand_on_scanned_ground_as_boxes(tmp_path, kind):
    shape = {
        "mesh": 'type="mesh" mesh="shell" mass="0.2" pos="0 0 -0.005"',
        "ellipsoid": 'type="ellipsoid" size="0.1 0.05 0.03" mass="0.2"',
    }[kind]
    mjcf = MJCF.replace('type="sphere" size="0.03" mass="0.2"', shape)
    spec = find_robot(f"{written(tmp_path, mjcf)}/").spec
    scene = replace(FLAT, solids=(field(0.15),))
    with World(spec, scene) as world:
        world.reset(position=(0.0, 0.0, 0.15 + spec.spawn_height), yaw=0.0)
        for _ in range(8):
            world.step(spec.default_pose)
        assert world.foot_contacts.all()
        assert world.trunk_position[2] == pytest.approx(0.15 + spec.spawn_height, abs=0.03)
    with World(spec, FLAT) as world:
        kinds = {int(world._model.geom_type[g]) for g in range(world._model.ngeom)}
        assert int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")) in kinds
