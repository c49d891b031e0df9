"""Robots as commands show them: listed, explained, drafted from a model file, put on the ground."""

import json
import math
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nw_base.errors import RobotError, UsageError
from nw_eval import api, cli
from nw_eval.cli.verbs.robots import check_page
from nw_scenes.robots import find_robot, get_robot
from nw_scenes.robots.standing import LevelGround, standing_pose

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
EXAMPLES = Path(__file__).parents[3] / "robots" / "examples"

LEG = """
      <body name="hip_{name}" pos="{x} {y} 0">
        <joint name="{name}_roll" axis="1 0 0" range="-0.8 0.8"/>
        <geom type="sphere" size="0.03" mass="0.5" contype="0" conaffinity="0"/>
        <body name="thigh_{name}">
          <joint name="{name}_thigh" axis="0 1 0" range="-1 3"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.6"/>
          <body name="shin_{name}" pos="0 0 -0.2">
            <joint name="{name}_knee" axis="0 1 0" range="-2.6 -0.5"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2"/>
            <geom type="sphere" pos="0 0 -0.2" size="0.025" mass="0.05"/>
          </body>
        </body>
      </body>"""
LEGS = [("fr", 0.2, -0.1), ("fl", 0.2, 0.1), ("rr", -0.2, -0.1), ("rl", -0.2, 0.1)]


def dog(legs=LEGS, actuator='<motor joint="{joint}" ctrlrange="-25 25"/>', more=""):
    """Return an MJCF of a trunk on legs of two links."""
    joints = [f"{name}_{part}" for name, _, _ in legs for part in ("roll", "thigh", "knee")]
    motors = "".join(actuator.format(joint=joint) for joint in joints)
    return (
        '<mujoco><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 0.5">'
        '<freejoint/><geom type="box" size="0.25 0.08 0.05" mass="8"/>'
        + "".join(LEG.format(name=name, x=x, y=y) for name, x, y in legs)
        + f"</body></worldbody><actuator>{motors}</actuator>{more}</mujoco>\n"
    )


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "dog" / "dog.xml"
    path.parent.mkdir()
    path.write_text(dog())
    return path


def left(argv):
    """Run a command, and return its exit code."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in argv])
    return ended.value.code


def test_a_model_alone_becomes_a_robot_that_stands(model, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert left(["robots", "init", model]) == 0
    said = capsys.readouterr().out
    text = (model.parent / "robot.yaml").read_text()
    assert text in said
    assert "; it stands" in said
    spec = find_robot("./dog").spec
    assert spec.feet == ("shin_fr", "shin_fl", "shin_rr", "shin_rl")
    assert spec.torque_limits == (25.0,) * 12
    assert set(spec.kp) == {25.0}
    # Each foot is under its hip: the thigh leans back by half of what the knee bends.
    by_joint = dict(zip(spec.joints, spec.default_pose, strict=True))
    assert by_joint["fl_thigh"] == pytest.approx(-by_joint["fl_knee"] / 2, abs=0.1)
    assert by_joint["fl_roll"] == 0.0
    # What is a guess says so, and what is not does not.
    marked = {line.split(":")[0].strip(" -") for line in text.splitlines() if "CHECK" in line}
    assert marked == {"# Lines with CHECK are guesses. Then", "pose", "{joints", "eye"}
    assert "4 lines to check" not in said
    assert "3 lines to check" in said
    before = (model.parent / "robot.yaml").read_bytes()
    assert left(["robots", "init", model]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (model.parent / "robot.yaml").read_bytes() == before
    assert left(["robots", "check", "./dog", "--out", "dog.png"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"shin_rl +\d+ N +\d\d%", said)
    assert "dog: it stands" in said
    picture = np.asarray(Image.open("dog.png").convert("RGB"))
    assert picture.std() > 20


def test_a_robot_whose_knees_give_way_does_not_stand(model, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    api.init_robot(model)
    file = model.parent / "robot.yaml"
    file.write_text(re.sub(r"kp: 25", "kp: 0.1", file.read_text()))
    assert left(["robots", "check", "./dog"]) == 1
    said = capsys.readouterr().out
    assert "dog: it does not stand" in said
    assert "gains do not hold the pose" in said


def test_that_it_stands_on_more_than_its_feet_is_in_the_first_line(model):
    api.init_robot(model)
    file = model.parent / "robot.yaml"
    file.write_text(file.read_text().replace(", shin_rl]", "]"))
    first, *_, last = check_page(api.check_robot(str(model.parent))).splitlines()
    said = r"dog: it stands, but (\w+, )*\w+ and shin_rl carry \d\d% of its weight"
    assert re.fullmatch(rf"{said}; \d+\.\d\d kg, of .*", first)
    assert re.fullmatch(said, last)


def test_out_gets_the_model_and_its_meshes_and_nothing_else(model, tmp_path):
    (model.parent / "secret.txt").write_text("no part of the robot")
    draft = api.init_robot(model, out=tmp_path / "new")
    assert draft.file == tmp_path / "new" / "robot.yaml"
    assert sorted(path.name for path in draft.file.parent.iterdir()) == ["dog.xml", "robot.yaml"]
    assert not (model.parent / "robot.yaml").exists()
    with pytest.raises(UsageError, match="exists already"):
        api.init_robot(model, out=tmp_path / "new")
    deeper = api.init_robot(model, out=tmp_path / "robots" / "b2")
    assert deeper.file == tmp_path / "robots" / "b2" / "robot.yaml"
    with pytest.raises(UsageError, match=r"dog\.xml is not a folder"):
        api.init_robot(model, out=model / "b2")


@pytest.mark.parametrize("name", ["7", "1e3", "no"])
def test_a_robot_may_be_called_by_what_yaml_takes_for_another_value(model, tmp_path, name):
    api.init_robot(model, out=tmp_path / name)
    assert api.show_robot(str(tmp_path / name)).name == name


def test_meshes_beside_the_folder_of_a_urdf_make_that_above_the_robots(tmp_path):
    import trimesh

    (tmp_path / "urdf").mkdir()
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((0.4, 0.2, 0.1)).export(tmp_path / "meshes" / "base.stl")
    link = (
        '<link name="{0}"><inertial><mass value="{1}"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
        'ixy="0" ixz="0" iyz="0"/></inertial><collision>{2}</collision></link>'
    )
    mesh = '<geometry><mesh filename="../meshes/base.stl"/></geometry>'
    ball = '<origin xyz="0 0 -0.3"/><geometry><sphere radius="0.04"/></geometry>'
    joint = (
        '<joint name="leg{0}" type="revolute"><parent link="base"/><child link="foot{0}"/>'
        '<origin xyz="{1} {2} 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="20" velocity="5"/></joint>'
    )
    corners = [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)]
    parts = [link.format("base", 5, mesh)]
    for number, (x, y) in enumerate(corners):
        parts += [link.format(f"foot{number}", 1, ball), joint.format(number, x, y)]
    (tmp_path / "urdf" / "four.urdf").write_text(f'<robot name="four">{"".join(parts)}</robot>')
    draft = api.init_robot(tmp_path / "urdf" / "four.urdf")
    assert draft.file == tmp_path / "robot.yaml"
    assert "model: {file: urdf/four.urdf}" in draft.text
    assert "no motors: all its hinges are driven" in draft.text
    spec = find_robot(f"{tmp_path}/").spec
    assert spec.torque_limits == (20.0,) * 4
    assert set(spec.feet) == {"foot0", "foot1", "foot2", "foot3"}


def test_servos_need_no_guess_of_gains_and_kv_is_damping(tmp_path):
    servo = '<position joint="{joint}" kp="60" kv="1.5" forcerange="-30 30"/>'
    (tmp_path / "dog.xml").write_text(dog(actuator=servo))
    draft = api.init_robot(tmp_path / "dog.xml")
    assert "kp:" not in draft.text
    spec = find_robot(f"{tmp_path}/").spec
    assert (set(spec.kp), set(spec.joint_damping)) == ({60.0}, {1.5})


def test_a_keyframe_in_which_it_lies_on_its_thighs_is_not_its_pose(tmp_path):
    lying = " ".join(["0 1.6 -0.5"] * 4)
    standing = " ".join(["0 0.7 -1.4"] * 4)
    keys = "".join(
        f'<key name="{name}" qpos="0 0 0.4 1 0 0 0 {pose}"/>'
        for name, pose in (("home", lying), ("stand", standing))
    )
    (tmp_path / "dog.xml").write_text(dog(more=f"<keyframe>{keys}</keyframe>"))
    assert "pose: stand  # the keyframe of dog.xml" in api.init_robot(tmp_path / "dog.xml").text


def test_a_biped_is_held_upright_and_falls_when_it_is_let_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "biped").mkdir()
    legs = [("right", 0.0, -0.1), ("left", 0.0, 0.1)]
    (tmp_path / "biped" / "biped.xml").write_text(dog(legs))
    draft = api.init_robot(tmp_path / "biped" / "biped.xml")
    assert "held upright" in draft.text
    assert re.search(r"fell: \{tilt: 1.2, height: 0\.\d+\}  # CHECK", draft.text)
    checked = api.check_robot("./biped")
    assert (checked.held, checked.stands) == (True, True)
    assert checked.fell_after is not None
    assert "it falls after" in checked.notes[0]


def test_feet_at_several_heights_are_all_found_where_the_robot_stands_on_them(tmp_path):
    """The rear legs are bent less in the pose: they alone are lowest, by 3 cm."""
    (tmp_path / "dog.xml").write_text(dog())
    (tmp_path / "robot.yaml").write_text(
        "nw-robot: 1\nname: dog\nmodel: {file: dog.xml}\nmotors: [{joints: '*', kp: 60, kd: 2}]\n"
        "pose: {'*_thigh': 0.7, '*_knee': -1.4, 'r[rl]_thigh': 0.57, 'r[rl]_knee': -1.15}\n"
    )
    spec = find_robot(f"{tmp_path}/").spec
    assert spec.feet == ("shin_fr", "shin_fl", "shin_rr", "shin_rl")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'size="0.25 0.08 0.05" mass="8"',
            'size="0.25 0.08 0.05" mass="8e6"',
            r"dog.xml:1:1: the robot weighs 8e\+06 kg, of which 'trunk' has 8e\+06 kg; 0.1 to",
        ),
        (
            "</mujoco>",
            '<equality>\n<connect body1="shin_fl" body2="shin_fr"/></equality></mujoco>',
            "dog.xml:54:1: <connect> closes a loop of shin_fl and shin_fr, and closed loops are",
        ),
        (
            'name="rl_roll" axis',
            'type="slide" name="rl_roll" axis',
            "dog.xml:42:1: joint 'rl_roll'",
        ),
        (
            'size="0.025" mass="0.05"/>\n          </body>\n        </body>\n      </body></body>',
            'size="x"/>\n          </body>\n        </body>\n      </body></body>',
            "dog.xml:50:1: MuJoCo cannot read it: XML Error: bad format in attribute 'size'",
        ),
        (
            "<worldbody>",
            '<include file="x.xml"/><worldbody>',
            "dog.xml:1:1: <include>: .x.xml. is not in the folder",
        ),
    ],
)
def test_an_error_of_the_model_names_its_line(tmp_path, old, new, said):
    text = dog()
    assert text.count(old) == 1
    (tmp_path / "dog.xml").write_text(text.replace(old, new))
    with pytest.raises(RobotError) as caught:
        api.init_robot(tmp_path / "dog.xml")
    assert re.search(said, str(caught.value)), caught.value
    assert not (tmp_path / "robot.yaml").exists()


def test_what_mujocos_compiler_refuses_is_told_with_body_and_line(tmp_path):
    text = dog().replace('size="0.015" mass="0.2"', 'size="0.015" mass="0"', 1)
    text = text.replace('size="0.025" mass="0.05"', 'size="0.025" mass="0"', 1)
    (tmp_path / "dog.xml").write_text(text)
    with pytest.raises(RobotError, match=r"dog.xml:8:1: MuJoCo .* mjMINVAL \(shin_fr\)"):
        api.init_robot(tmp_path / "dog.xml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('range="-1 3"', 'range="-60 170"', "ranges of over two turns"),
        ('range="-1 3"', 'range="-0.017 0.05"', "ranges of over two turns or under 5 degrees"),
        ('ctrlrange="-25 25"', 'ctrlrange="-999 999"', "torque of over 1 m of its weight"),
    ],
)
def test_numbers_that_no_robot_has_are_to_be_checked(model, old, new, said):
    text = model.read_text()
    assert said not in api.init_robot(model).text
    model.write_text(text.replace(old, new))
    (model.parent / "robot.yaml").unlink()
    assert f"CHECK: {said}" in api.init_robot(model).text


def test_a_joint_without_a_range_is_noted_with_its_line(model):
    text = model.read_text().replace(
        'name="rl_thigh" axis="0 1 0" range="-1 3"', 'name="rl_thigh" axis="0 1 0"'
    )
    model.write_text(text)
    draft = api.init_robot(model)
    assert "joints without a range in the file: rl_thigh" in draft.text
    checked = api.check_robot(f"{model.parent}/")
    line = 1 + text[: text.index('"rl_thigh"')].count("\n")
    assert f"joints without a range: rl_thigh (dog.xml:{line})" in checked.notes


@pytest.mark.parametrize(
    "line",
    ["spawn_height: 1e9", "motors: [{joints: '*', kp: 1e300, kd: 1}]", "collided: {force: 1e9}"],
)
def test_numbers_that_no_robot_has_are_refused(model, line, capsys):
    head = "nw-robot: 1\nname: dog\nmodel: {file: dog.xml}\n"
    motors = "" if line.startswith("motors") else "motors: [{joints: '*', kp: 60, kd: 2}]\n"
    (model.parent / "robot.yaml").write_text(f"{head}{motors}{line}\n")
    assert left(["robots", "check", f"{model.parent}/"]) == 2
    assert re.search(r"robot.yaml:[45]:\d+: .*must be at most", capsys.readouterr().err)


def test_show_says_every_figure_and_the_line_that_it_is_from(model, capsys):
    api.init_robot(model)
    assert left(["robots", "show", f"{model.parent}/"]) == 0
    page = capsys.readouterr().out
    lines = (model.parent / "robot.yaml").read_text().splitlines()
    motors = 1 + next(n for n, line in enumerate(lines) if "joints:" in line)
    assert re.search(
        rf"fr_knee .* 25 .*dog.xml:\d+, dog.xml:\d+, robot.yaml:{motors}$", page, re.MULTILINE
    )
    assert "derived: the lowest point that collides" in page
    assert left(["robots", "show", f"{model.parent}/", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["mass"] == pytest.approx(8 + 4 * 1.35)
    assert [joint["joint"] for joint in said["joints"]][:3] == ["fr_roll", "fr_thigh", "fr_knee"]
    assert said["sources"]["feet"].startswith("robot.yaml:")


def test_the_list_has_built_in_robots_and_folders_and_says_what_is_wrong_with_one(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for name in ("hound", "bad"):
        folder = tmp_path / "robots" / name
        folder.mkdir(parents=True)
        (folder / "dog.xml").write_text(dog() if name == "hound" else "<mujoco>")
        (folder / "robot.yaml").write_text(
            f"nw-robot: 1\nname: {name}\nmodel: {{file: dog.xml}}\n"
            "motors: [{joints: '*', kp: 60, kd: 2}]\n"
        )
    assert left(["robots", "list"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert re.search(r"12 +4 +13\.0 kg +0\.40 m  nw-eval", lines["go1"])
    assert re.search(r"12 +4 +13\.4 kg +0\.\d\d m  .*/robots/hound$", lines["hound"])
    assert "is not XML" in lines["bad"]


def test_go1_stands_on_its_own_feet():
    checked = api.check_robot("go1")
    assert checked.stands
    assert [foot.foot for foot in checked.feet] == ["FR", "FL", "RR", "RL"]
    weight = checked.mass * 9.806
    assert sum(foot.force for foot in checked.feet) == pytest.approx(weight, rel=0.02)
    assert checked.others == ()


def test_the_stance_of_go1_is_guessed_from_its_legs():
    robot = get_robot("go1")
    pose = standing_pose(robot)
    assert pose is not None
    angles = [pose.get(name, 0.0) for name in robot.joints]
    dropped = LevelGround(robot).drop(angles)
    assert dropped.stands
    assert math.acos(dropped.upright) < 0.15


@pytest.mark.assets
@pytest.mark.parametrize(("name", "folder"), [("b2", "b2"), ("g1", "g1")])
def test_the_examples_stand_with_the_models_that_they_are_for(name, folder, tmp_path):
    models = ASSETS / "robots" / folder
    if not models.is_dir():
        pytest.skip(f"{models} is not here")
    shutil.copytree(models, tmp_path / name)
    (tmp_path / name).chmod(0o755)
    shutil.copy(EXAMPLES / name / "robot.yaml", tmp_path / name)
    checked = api.check_robot(f"{tmp_path / name}/")
    assert checked.stands
    assert checked.name == name
    assert len(checked.feet) == (4 if name == "b2" else 2)
    assert min(foot.force for foot in checked.feet) > 0.1 * checked.mass * 9.806


@pytest.mark.assets
def test_a_checkpoint_is_drafted_for_the_folder_of_a_robot(tmp_path):
    models, policy = ASSETS / "robots" / "g1", ASSETS / "policies" / "g1-unitree-rl-gym"
    if not models.is_dir():
        pytest.skip(f"{models} is not here")
    robot = api.init_robot(models / "g1_12dof.xml", out=tmp_path / "g1")
    assert robot.stands
    (tmp_path / "policy").mkdir()
    checkpoint = shutil.copy(policy / "policy.pt", tmp_path / "policy")
    draft = api.init_policy(Path(checkpoint), robot=f"{tmp_path / 'g1'}/")
    assert "robot: g1\n" in draft.text
    assert "joints: [left_hip_pitch, left_hip_roll" in draft.text
    assert "FL_hip" not in draft.text
    assert "left_knee: 140" in draft.text  # Its own gain, not that of a published layout.
    page = api.show_policy(str(tmp_path / "policy"), robot=f"{tmp_path / 'g1'}/")
    assert page.joints[3].kp == 140
    with pytest.raises(RobotError, match=r"is the robot 'go1', and .* is a card of 'g1'"):
        api.check_policy(str(tmp_path / "policy"), robot="go1")


def test_a_fault_of_a_suites_robot_is_told_once_and_not_as_an_unknown_robot_of_the_card(
    model, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    head = "nw-robot: 1\nname: spaniel\nmodel: {file: dog.xml}\n"
    (model.parent / "robot.yaml").write_text(f"{head}motors: [{{joints: '*', kp: 1e300}}]\n")
    card = "nw-policy: 1\nname: still\nrobot: spaniel\nadapter: zero\n"
    control = "control: {action: joint_position_offset, scale: 0.25}\n"
    (tmp_path / "still.yaml").write_text(card + control)
    suite = "nw-eval: 1\nname: s\nrobot: ./dog\npolicy: ./still.yaml\ntrials: 1\nseed: 1\n"
    (tmp_path / "s.yaml").write_text(f"{suite}scenes: [flat/carpet_room]\nrecord: none\n")
    assert left(["check", "s.yaml"]) == 2
    said = capsys.readouterr().err
    assert "kp: must be at most 100000" in said
    assert "unknown robot" not in said
