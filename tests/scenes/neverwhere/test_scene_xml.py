"""Scene XML: what strangers may write in it, and poses against MuJoCo's own reading."""

import mujoco
import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes.neverwhere import load_published
from nw_scenes.neverwhere.files import Places, read_xml
from nw_scenes.neverwhere.tree import read_tree
from nw_scenes.scene import Box, Primitive

BOMB = """<?xml version="1.0"?>
<!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>
<mujoco model="&b;"/>"""

TERRAIN = """<mujoco>
  <compiler angle="{unit}" eulerseq="{sequence}"/>
  <default>
    <geom friction="0.9 0.2 0.1"/>
    <default class="post"><geom type="cylinder" size="0.05 0.2"/>
      <default class="thin"><geom size="0.02 0.3"/></default></default>
  </default>
  <worldbody>
    <geom type="plane" size="0 0 1" pos="0 0 -0.4064"/>
    <body name="block" pos="1 2 0.1" euler="{e}">
      <geom type="box" size="0.3 0.2 0.1" pos="0.1 0 0" quat="0.8 0.1 -0.3 0.5"/>
      <body name="inner" pos="0.2 0.1 0.5" axisangle="1 2 3 {a}" childclass="post">
        <geom name="post"/>
        <geom name="thin" class="thin" zaxis="0.3 -0.2 0.5"/>
        <geom name="ball" type="sphere" size="0.1" friction="0.5"/>
      </body>
    </body>
    <frame pos="-1 0 0.3" euler="{e}">
      <body name="framed" xyaxes="1 0.2 0 -0.1 1 0.3">
        <geom type="capsule" size="0.05" fromto="0 0 0 0.4 0.1 0.2"/>
        <geom type="ellipsoid" size="0.3 0.2 0.1"/>
        <geom type="box" contype="0" conaffinity="0" size="1 1 1"/>
      </body>
    </frame>
    <body name="waypoint-1" pos="1 0 0.2"/>
    <body name="waypoint-0" pos="0.5 0 0.2"><geom type="box" size="0.1 0.1 0.1"/></body>
  </worldbody>
</mujoco>"""


def terrain(tmp_path, unit="radian", sequence="xyz", name="gaps_made_up", **changes):
    turn = 1.0 if unit == "radian" else 180 / np.pi
    e = " ".join(str(turn * v) for v in (0.3, -0.5, 0.9))
    text = TERRAIN.format(unit=unit, sequence=sequence, e=e, a=turn * 0.7)
    for old, new in changes.items():
        text = text.replace(old, new)
    folder = tmp_path / name
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.xml").write_text(text)
    return folder


@pytest.mark.parametrize("unit", ["radian", "degree"])
@pytest.mark.parametrize("sequence", ["xyz", "zyx", "XYZ", "zxy", "YXZ"])
def test_poses_and_defaults_are_what_mujoco_reads(tmp_path, unit, sequence):
    folder = terrain(tmp_path, unit, sequence)
    xml = folder / "gaps_made_up.xml"
    model = mujoco.MjModel.from_xml_path(str(xml))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tree = read_tree(Places(xml=xml, folder=folder, name="x"))
    for name, T in tree.bodies.items():
        assert T[:3, 3] == pytest.approx(data.body(name).xpos, abs=1e-12)
        assert T[:3, :3] == pytest.approx(data.body(name).xmat.reshape(3, 3), abs=1e-12)
    scene = load_published(folder)
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] and model.geom_type[g] != 0]
    # MuJoCo's order: by body; the last one marks a waypoint.
    assert len(scene.solids) == len(solid) - 1
    for index, ours in zip(solid, scene.solids, strict=False):
        assert np.array(ours.center) == pytest.approx(data.geom_xpos[index], abs=1e-9)
        size = ours.half_size if isinstance(ours, Box) else ours.size
        assert np.array(size) == pytest.approx(model.geom_size[index][: len(size)], abs=1e-9)
        assert np.array(ours.friction) == pytest.approx(model.geom_friction[index])
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, np.array(ours.quat))
        if isinstance(ours, Primitive) and ours.kind == "capsule":
            # Round about its axis: that alone is compared.
            axis, other = turned.reshape(3, 3)[:, 2], data.geom_xmat[index].reshape(3, 3)[:, 2]
            assert abs(axis @ other) == pytest.approx(1.0)
        else:
            assert turned == pytest.approx(data.geom_xmat[index], abs=1e-9)


def test_a_parametric_terrain_is_a_scene(tmp_path):
    scene = load_published(terrain(tmp_path))
    assert scene.task == "gaps"
    assert scene.ground.z == pytest.approx(-0.4064)
    assert scene.trail.tolist() == [[0.5, 0, 0.2], [1, 0, 0.2]]
    assert scene.splat is None


def test_included_terrain_and_an_absent_robot_are_understood(tmp_path):
    """LucidSim: scene XML with a robot's and a terrain's file; the robot's angles are radians."""
    folder = tmp_path / "stairs_v2"
    folder.mkdir()
    steps = "".join(
        f'<body name="step{i}" pos="{1.6952 + 0.3048 * (i + 0.5)} 0 {0.127 * (i + 1) / 2}">'
        f'<geom type="box" size="0.1524 2.25 {0.127 * (i + 1) / 2}"/></body>'
        for i in range(5)
    )
    marks = "".join(
        f'<body name="waypoint-{k}" pos="{1.6952 + 0.3048 * (i + 0.5)} 0 {0.127 * (i + 1)}"/>'
        for k, i in enumerate((0, 2, 4))
    )
    (folder / "terrain.xml").write_text(
        f'<mujocoinclude><worldbody><geom type="plane" size="0 0 1"/>{steps}{marks}'
        '<body pos="9 0 0.2" euler="0 0 1.5707963267948966"><geom type="box" size=".1 .5 .2"/>'
        "</body></worldbody></mujocoinclude>"
    )
    (folder / "stairs_v2.xml").write_text(
        '<mujoco><include file="go1/go1.xml"/><include file="terrain.xml"/></mujoco>'
    )
    scene = load_published(folder)
    assert scene.task == "stairs"
    assert len(scene.solids) == 6
    assert scene.trail[:, 2] == pytest.approx([0.127, 0.381, 0.635])
    # Without friction of its own a geom has that of the robot's file: 1.0 0.3 0.3.
    assert scene.solids[0].friction == (1.0, 0.3, 0.3)
    assert abs(scene.solids[5].quat[3]) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "document type"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><mujoco/>', "document type"),
        ("<mujoco><body></mujoco>", "not well formed"),
        ("", "not well formed"),
        ("<scene/>", "not MJCF"),
        ("<mujoco>" + "<body>" * 100 + "</body>" * 100 + "</mujoco>", "deep"),
        ('<mujoco><include file="none.xml"/></mujoco>', "no file"),
        ('<mujoco><include file="../x.xml"/></mujoco>', r"'\.\.'"),
        ('<mujoco><include file="/x.xml"/></mujoco>', "absolute"),
        ('<mujoco><include file="a.xml"/></mujoco>', "includes itself"),
        ('<mujoco><compiler angle="turns"/></mujoco>', "turns"),
        ('<mujoco><compiler eulerseq="abc"/></mujoco>', "abc"),
        ('<mujoco><worldbody><body name="a" pos="1 2"/></worldbody></mujoco>', "2 numbers"),
        ('<mujoco><worldbody><body pos="1 2 inf"/></worldbody></mujoco>', "not finite"),
        ('<mujoco><worldbody><body quat="0 0 0 0"/></worldbody></mujoco>', "zero"),
        ('<mujoco><worldbody><geom class="x"/></worldbody></mujoco>', "default class"),
        ("<mujoco><worldbody><replicate/></worldbody></mujoco>", "replicate"),
        (
            '<mujoco><worldbody><body name="a"/><body name="a"/></worldbody></mujoco>',
            "second body",
        ),
    ],
)
def test_bad_xml_is_a_named_error(tmp_path, text, words):
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(SceneError, match=words) as error:
        load_published(tmp_path / "a.xml")
    assert "a.xml" in str(error.value)


@pytest.mark.parametrize(
    ("geom", "words"),
    [
        ('<geom type="box" size="1 1 0"/>', "makes no box"),
        ('<geom type="box" size="1"/>', "makes no box"),
        ('<geom type="hfield" hfield="x"/>', "hfield"),
        ('<geom type="plane" size="1 1 1" euler="0.1 0 0"/>', "tilted"),
    ],
)
def test_solids_that_make_no_sense_are_named(tmp_path, geom, words):
    (tmp_path / "a.xml").write_text(
        f'<mujoco><worldbody>{geom}<body name="waypoint"/></worldbody></mujoco>'
    )
    with pytest.raises(SceneError, match=words):
        load_published(tmp_path / "a.xml")


def test_elements_know_their_lines(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text('<mujoco>\n\n<asset>\n<mesh name="m"/></asset></mujoco>')
    (asset,) = read_xml(path).children
    assert (asset.line, asset.children[0].line) == (3, 4)


def test_a_large_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "a.xml"
    with path.open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(SceneError, match="20000000 bytes"):
        read_xml(path)
