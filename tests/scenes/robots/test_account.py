"""What a model file of a robot says is used, named as of no effect, named as lost, or refused."""

import re
from contextlib import suppress
from dataclasses import replace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh

from nw_base.errors import RobotError
from nw_scenes.mesh import merge
from nw_scenes.robots.account import PASSED, Account
from nw_scenes.robots.derived import spec_of
from nw_scenes.robots.folder import KNOWN, read_folder
from nw_scenes.scene import Scene
from nw_sim.physics import World
from nw_sim.physics.model import add_geometry
from nw_sim.probe.robot_draft import draft_robot

FLAT = Scene(
    name="tests/flat",
    task="hurdles",
    title="",
    solids=(),
    trail=np.array([[1.0, 0.0, 0.0]]),
    static_mesh=merge([]),
    splat=None,
)
# A leg of each kind of motor, and one of everything else that a robot may have.
KINDS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder")
KINDS = (*KINDS, "pid", "dcmotor")
GIVEN = {
    "general": 'gainprm="20" biastype="affine" biasprm="0 -20 -1" forcerange="-9 9"',
    "motor": 'ctrlrange="-8 8" forcerange="-6 6"',
    "position": 'kp="30" forcerange="-9 9"',
    "velocity": 'kv="2" forcerange="-9 9"',
    "intvelocity": 'kp="10" actrange="-1 1" forcerange="-9 9"',
    "damper": 'ctrlrange="0 1" forcerange="-9 9"',
    "cylinder": 'forcerange="-9 9"',
    "pid": 'kp="5" forcerange="-9 9"',
    "dcmotor": 'motorconst="0.05" resistance="1"',
}
LEG = """
<body name="leg_{0}" pos="{1} 0 0"><joint name="{0}" axis="0 1 0" range="-1 1"/>
<geom name="shin_{0}" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body>
"""
MJCF = f"""
<mujoco>
  <compiler/>
  <asset>
    <mesh name="shell" file="sub/shell.stl"/>
    <mesh name="inline" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>
    <material name="red" rgba="1 0 0 1"/>
  </asset>
  <worldbody>
    <body name="base" pos="0 0 0.5">
      <freejoint/>
      <inertial mass="5" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>
      <geom name="hull" type="box" size="0.3 0.1 0.05" pos="0.01 0.02 0.03"/>
      <geom name="mesh" type="mesh" mesh="shell" material="red"/>
      <geom name="inline" type="mesh" mesh="inline" contype="0" conaffinity="0"/>
      <geom name="fit" type="box" mesh="inline"/>
      <site name="one"/><site name="two" pos="0 0 0.1"/>
      <camera name="front" pos="0.3 0 0"/>
      {"".join(LEG.format(kind, n / 10) for n, kind in enumerate(KINDS))}
      <body name="tail" pos="-0.3 0 0" euler="10 20 30">
        <joint name="wag" axis="0 0 1"/><geom name="tail" size="0.02" mass="0.1"/>
        <site name="three"/>
      </body>
    </body>
  </worldbody>
  <contact>
    <pair geom1="hull" geom2="tail"/>
    <exclude body1="leg_motor" body2="tail"/>
  </contact>
  <tendon>
    <spatial name="rope"><site site="one"/><site site="three"/></spatial>
    <fixed name="sum"><joint joint="wag" coef="1"/><joint joint="motor" coef="2"/></fixed>
    <fixed name="other"><joint joint="wag" coef="1"/></fixed>
  </tendon>
  <equality>
    <joint joint1="wag" joint2="motor"/>
    <tendon tendon1="sum" tendon2="other"/>
  </equality>
  <actuator>
    {"".join(f'<{kind} name="{kind}" joint="{kind}" {GIVEN.get(kind, "")}/>' for kind in KINDS)}
  </actuator>
</mujoco>
"""
YAML = """\
nw-robot: 1
name: marked
model: {file: robot.xml}
motors:
  - {joints: [motor, damper, cylinder, pid, dcmotor], kp: 40}
  - {joints: dcmotor, torque: 3}
"""

_NAMES = """
    name class childclass joint joint1 joint2 jointinparent body body1 body2 geom1 geom2 site site1
    site2 tendon tendon1 tendon2 mesh material hfield target refsite cranksite slidersite texture
    instance plugin joint geom sidesite model file key objname"""
NAMES = frozenset(_NAMES.split())
"""What ties the parts of a file together: without it the model is another one, or none."""


def schema():
    """Yield the path of each element of MJCF and its attributes, as MuJoCo itself tells them."""
    path = []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        named = re.match(r"( *)(\(?[\w)]+) \([!*?R]\) +(.*)", line)
        if named:
            depth = len(named[1]) // 3
            tag = named[2].replace("(world)", "")
            path = [*path[:depth], tag]
            words = named[3].split()
        else:
            words = line.split()
        for word in words:
            yield tuple(path), word


MARKS = {
    "actdim": "1", "actearly": "true", "active": "false", "actlimited": "true",
    "actrange": "-2 2", "actuatorfrclimited": "true", "actuatorfrcrange": "-3 3",
    "actuatorgravcomp": "true", "adhesion": "2", "align": "true", "alignfree": "true",
    "angle": "degree", "area": "2", "armature": "0.3", "assetdir": "meshes",
    "autolimits": "false", "axis": "1 0 0", "axisangle": "0 0 1 0.3", "balanceinertia": "true",
    "bias": "1 2 3", "biasprm": "0 -20 -3", "biastype": "none", "boundinertia": "0.4",
    "boundmass": "0.6", "builtin": "sphere", "castshadow": "false", "coef": "3", "cogging": "1 2 3",
    "conaffinity": "2", "condim": "4", "conflict": "error", "contype": "2",
    "controller": "1 1 1", "coordinate": "local", "cranklength": "0.5", "ctrllimited": "true",
    "ctrlrange": "-2 2", "damping": "0.7", "dampratio": "0.5", "delay": "0.1", "density": "700",
    "diaginertia": "0.2 0.2 0.2", "diameter": "0.2", "discardvisual": "true", "divisor": "2",
    "dynprm": "2", "dyntype": "filter", "euler": "0.1 0.2 0.3", "eulerseq": "zyx",
    "face": "0 2 1 0 1 3 0 3 2", "fitaabb": "true", "fitscale": "2",
    "input": "pos vel", "fluidcoef": "1 1 1 1 1",
    "fluidshape": "ellipsoid", "focal": "1 1", "forcelimited": "false", "forcerange": "-7 7",
    "fovy": "33", "friction": "0.7 0.01 0.001", "frictionloss": "0.4", "fromto": "0 0 0 0 0 1",
    "fullinertia": "0.2 0.2 0.2 0 0 0", "fuse": "true", "fusestatic": "true", "gainprm": "25",
    "gaintype": "affine", "gap": "0.01", "gear": "2", "gravcomp": "0.5", "group": "1",
    "imax": "2", "inductance": "1 1", "inertia": "shell", "inertiafromgeom": "true",
    "inertiagrouprange": "0 1", "inheritrange": "1", "interp": "1", "ki": "2", "kp": "17",
    "kv": "3", "lengthrange": "0 1", "limited": "false", "lugre": "1 2 3 4 5", "margin": "0.02",
    "mass": "0.9", "maxhullvert": "4", "meshdir": "meshes", "metallic": "1", "mocap": "true",
    "mode": "track", "motorconst": "0.2", "nominal": "1 2 3", "nsample": "4", "polycoef": "0 2",
    "pos": "0.1 0.2 0.3", "priority": "2", "quat": "0.6 0.8 0 0", "range": "-0.5 0.5",
    "ref": "0.2", "refpos": "0.1 0 0", "refquat": "0.6 0.8 0 0", "resistance": "3",
    "rgba": "0.1 0.2 0.3 1", "scale": "2 2 2", "settotalmass": "17", "shellinertia": "true",
    "size": "0.11 0.12 0.13", "slewmax": "2", "smoothnormal": "true", "solimp": "0.8 0.9 0.01",
    "solimpfriction": "0.8 0.9 0.01", "solimplimit": "0.8 0.9 0.01", "solmix": "3",
    "solref": "0.03 1", "solreffriction": "0.03 1", "solreflimit": "0.03 1",
    "springdamper": "0.1 1", "springlength": "0.25", "springref": "0.2", "springyield": "0.2",
    "stiffness": "5", "strippath": "true", "surfacevel": "1 0 0 0 0 0", "texturedir": "looks",
    "thermal": "1 2 3 4 5 6", "timeconst": "0.1", "type": "ellipsoid", "user": "7",
    "usethread": "false", "vertex": "0 0 0 .2 0 0 0 .1 0 0 0 .1", "width": "0.02",
    "xyaxes": "0 1 0 -1 0 0", "zaxis": "0 1 0",
}  # fmt: skip
"""A value of each attribute that is not its default; others get "1"."""
MARKS_OF = {
    ("compiler", "angle"): "radian",
    ("compiler", "coordinate"): "global",
    ("joint", "actuatorfrclimited"): "false",
    ("spatial", "actuatorfrclimited"): "false",
    ("fixed", "actuatorfrclimited"): "false",
    ("option", "impratio"): "100",
    ("compiler", "autolimits"): "false",
    ("joint", "type"): "slide",
    ("motor", "ctrllimited"): "false",
    ("cylinder", "bias"): "1 2 3",
    ("mesh", "inertia"): "shell",
    ("mesh", "scale"): "2 2 2",
    ("equality", "polycoef"): "0 2",
    ("general", "dynprm"): "2",
}
"""Values of an attribute of one element."""
WHERE = {
    ("mesh", "vertex"): "inline",
    ("mesh", "face"): "inline",
    ("geom", "fitscale"): "fit",
    ("geom", "fromto"): "shin_motor",
    ("geom", "group"): "fit",
    ("geom", "fluidcoef"): "tail",
}
"""The element by name, else the first."""
WITH = {
    ("joint", "actuatorfrclimited"): 'actuatorfrcrange="-3 3"',
    ("spatial", "actuatorfrclimited"): 'actuatorfrcrange="-3 3"',
    ("fixed", "actuatorfrclimited"): 'actuatorfrcrange="-3 3"',
    ("spatial", "springlength"): 'stiffness="5"',
    ("fixed", "springlength"): 'stiffness="5"',
    ("site", "fromto"): 'type="capsule"',
    ("motor", "ctrllimited"): 'forcerange="-20 20"',
}
"""What else an element needs for an attribute to be of any effect."""
INSTEAD = {
    ("compiler", "balanceinertia"): ('diaginertia="0.1 0.1 0.1"', 'diaginertia="0.1 0.1 0.3"'),
    ("geom", "group"): (
        "<compiler/>",
        '<compiler inertiafromgeom="true" inertiagrouprange="0 0"/>',
    ),
}
"""What another place of the file needs."""
SAID = {
    ("freejoint", "align"): "of a robot of one body alone",
    ("general", "actearly"): "of motors with states, which are said",
    ("general", "dynprm"): "of motors with states, which are said",
}
"""Attributes that mean nothing in a robot, and why."""


def written(folder):
    """Write meshes of different sizes wherever a path may lead."""
    for size, name in enumerate(("shell", "sub/shell", "meshes/shell", "meshes/sub/shell"), 1):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.box((0.1 * size, 0.1, 0.05)).export(folder / f"{name}.stl")


def read(folder, text, yaml=YAML):
    """Return a robot and the account of its file; None where that is all that need be asked."""
    (folder / "robot.xml").write_text(text)
    read = read_folder(folder, yaml)
    account = read.account
    if account.passed or any("motor" not in each for each in account.lost):
        return None, account
    return spec_of(read), account


def marked(path, key, with_mark=True):
    """Return the file with a mark at an attribute of one element, which is there or is added."""
    tag = path[-1]
    element = root = ET.fromstring(MJCF.replace(*INSTEAD.get((tag, key), ("", ""))))
    for step in path[1:]:
        parent, name = element, WHERE.get((tag, key)) if step == tag else None
        found = [e for e in parent.iter(step) if e is not parent and name in {None, e.get("name")}]
        element = found[0] if found else ET.SubElement(parent, step)
    for other, value in re.findall(r'(\w+)="([^"]*)"', WITH.get((tag, key), "")):
        element.set(other, value)
    if with_mark:
        element.set(key, MARKS_OF.get((tag, key), MARKS.get(key, "1")))
    return ET.tostring(root, encoding="unicode")


def outcomes(folder, path, key, plain):
    """Return in which of four ways a mark is told: used, passed, lost, refused."""
    base = plain
    if (path[-1], key) in {*WITH, *INSTEAD}:
        with suppress(RobotError):
            base = read(folder, marked(path, key, with_mark=False))
    try:
        spec, account = read(folder, marked(path, key))
    except RobotError as error:
        message = str(error).split(": ", 1)[1]
        return ["refused"] if any(word in message for word in (*path[1:], key)) else [message]
    found = []
    if spec is not None and spec != base[0]:
        found.append("used")
    if any(key in each or path[-1] in each for each in set(account.lost) - set(base[1].lost)):
        found.append("lost")
    if not found and any(f"motor '{path[-1]}'" in each for each in account.lost):
        found.append("lost")  # This kind of motor is said as a whole.
    if found == ["used", "lost"]:
        found = ["lost"]
    tags = [f"<{tag}>" for tag in path[1:]]
    passed = [what for of in account.passed.values() for what in of]
    if any(key in what or what in tags for what in passed):
        found.append("passed")
    return found


def test_each_attribute_of_mjcf_is_used_or_passed_over_or_said_or_refused(tmp_path):
    written(tmp_path)
    plain = read(tmp_path, MJCF)
    whole: set[tuple[str, ...]] = set()  # elements that are told as a whole
    wrong, counts = [], dict.fromkeys(("used", "passed", "lost", "refused"), 0)
    for path, key in schema():
        if "default" in path or key in NAMES or (path[-1], key) in SAID:
            continue  # Defaults are those of the same elements.
        if any(path[:depth] in whole for depth in range(2, len(path) + 1)):
            continue
        found = outcomes(tmp_path, path, key, plain)
        if len(found) != 1 or found[0] not in counts:
            wrong.append((path[1:], key, found))
        else:
            counts[found[0]] += 1
        if found in (["passed"], ["refused"]):
            account = Account()
            element = ET.Element(path[-1])
            if account.leaves_out(element, "mujoco", 1) or path[-1] not in KNOWN:
                whole.add(path)
    assert not wrong, "\n".join(map(str, wrong))
    assert min(counts.values()) > 9  # A reader that takes, or refuses, everything is none.


URDF = """
<robot name="stick">
  <link name="base"><inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="3"/>
    <inertia ixx="0.1" iyy="0.12" izz="0.14" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.2 0.1 0.1"/></geometry>
      <material name="red"><color rgba="1 0 0 1"/></material></visual></link>
  <link name="foot"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.3" rpy="0 0 0"/><geometry><sphere radius="0.04"/></geometry>
    </collision></link>
  <link name="toe"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><cylinder radius="0.02" length="0.1"/></geometry></collision>
    <collision><geometry><capsule radius="0.02" length="0.1"/></geometry></collision></link>
  <joint name="hip" type="revolute"><origin xyz="0 0 0" rpy="0 0 0"/><parent link="base"/>
    <child link="foot"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="33"/>
    <dynamics damping="0.5" friction="0.2"/></joint>
  <joint name="ankle" type="revolute"><parent link="foot"/><child link="toe"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20"/>
    <mimic joint="hip" multiplier="1" offset="0"/></joint>
</robot>
"""
URDF_YAML = """\
nw-robot: 1
name: stick
model: {file: robot.xml}
motors: [{joints: "*", kp: 9}]
"""
OF_URDF = {
    "robot": "version",
    "link": "type",
    "origin": "xyz rpy",
    "mass": "value",
    "inertia": "ixx iyy izz ixy ixz iyz",
    "box": "size",
    "sphere": "radius",
    "cylinder": "radius length",
    "capsule": "radius length",
    "color": "rgba",
    "texture": "filename",
    "joint": "type",
    "axis": "xyz",
    "calibration": "rising falling reference_position",
    "dynamics": "damping friction",
    "limit": "lower upper effort velocity acceleration deceleration jerk",
    "mimic": "multiplier offset",
    "safety_controller": "soft_lower_limit soft_upper_limit k_position k_velocity",
    "transmission": "name",
    "sensor": "name",
    "gazebo": "reference",
    "model_state": "model time_stamp",
    "contact": "lateral_friction",
    "verbose": "value",
    "ros2_control": "name type",
    "joint_properties": "damping friction",
    "self_filter": "scale",
}
"""Attributes of URDF's specification (urdf.xsd), and of what others write into such files."""
URDF_MARKS = {"rgba": "0 1 0 1", "xyz": "1 0 0", "rpy": "0.1 0.2 0.3", "type": "continuous"}
URDF_MARKS |= {"size": "0.3 0.2 0.1", "upper": "0.7", "lower": "-0.7", "filename": "a.png"}
URDF_MARKS |= {"ixy": "0.01", "ixz": "0.01", "iyz": "0.01", "radius": "0.03", "length": "0.2"}
URDF_MARKS |= {"ixx": "0.11", "iyy": "0.11", "izz": "0.11"}


@pytest.mark.parametrize("tag", OF_URDF)
def test_each_attribute_of_urdf_is_used_or_passed_over_or_said(tmp_path, tag):
    def robot(text):
        (tmp_path / "robot.xml").write_text(text)
        folder = read_folder(tmp_path, URDF_YAML)
        return spec_of(folder), folder.account

    base, _ = robot(URDF)
    assert base.joints == ("hip",)  # `ankle` follows it.
    assert (base.joint_damping, base.friction_loss) == ((0.5,), (0.2,))
    parents = {"texture": "material", "contact": "link", "joint_properties": "joint"}
    for key in OF_URDF[tag].split():
        root = ET.fromstring(URDF)
        found = next(root.iter(tag), None)
        if found is None:
            parent = parents.get(tag, "joint" if tag == "calibration" else "robot")
            found = ET.SubElement(next(root.iter(parent)), tag)
        found.set(key, URDF_MARKS.get(key, "0.7"))
        spec, account = robot(ET.tostring(root, encoding="unicode"))
        words = f"<{tag}>"
        told = [
            spec != base,
            any(words in each and (key in each or each.startswith(words)) for each in account.lost),
            any(words in what for of in account.passed.values() for what in of),
        ]
        assert sum(told) == 1, (key, told, account)


def told(tmp_path, text, yaml=URDF_YAML):
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(RobotError) as caught:
        spec_of(read_folder(tmp_path, yaml))
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_what_only_xacro_reads_is_not_a_urdf_yet(tmp_path):
    head = '<robot name="stick" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    text = URDF.replace('<robot name="stick">', head)
    for old, new, words in (
        ('value="3"', 'value="${mass}"', 'value="${mass}"'),
        ("</robot>", '<xacro:leg side="left"/></robot>', "<xacro:leg>"),
    ):
        assert told(tmp_path, text.replace(old, new)) == (
            f"robot.xml:1:1: it is no URDF yet: it has {words}, which only xacro reads; "
            "expand it: `xacro FILE > robot.urdf`"
        )
    unused = text.replace("</robot>", '<xacro:property name="w" value="1"/></robot>')
    (tmp_path / "robot.xml").write_text(unused)
    folder = read_folder(tmp_path, URDF_YAML)
    assert folder.account.passed == {"nothing uses it": {"<xacro:property>": None}}


def test_a_shape_that_urdf_has_not_is_named(tmp_path):
    text = URDF.replace('<sphere radius="0.04"/>', '<cone radius="0.04"/>')
    assert "<cone> is not a URDF shape; use one of box, sphere, cylinder, capsule, mesh" in told(
        tmp_path, text
    )


def test_an_inertia_that_no_body_has_is_balanced_and_said(tmp_path):
    text = URDF.replace('izz="0.14"', 'izz="0.5"')
    (tmp_path / "robot.xml").write_text(text)
    folder = read_folder(tmp_path, URDF_YAML)
    spec_of(folder)
    (said,) = folder.account.sentences()
    assert said.startswith("inertia of <link base>, and others: no body has it, as A + B < C")


def test_products_of_inertia_that_no_body_has_are_left_out_and_said(tmp_path):
    found = re.search(r'<inertia ixx="([\d.]+)"[^>]*/>', URDF)
    size = found[1]
    rest = f'iyy="{size}" izz="{size}" ixy="{size}" ixz="{size}" iyz="{size}"'
    (tmp_path / "robot.xml").write_text(URDF.replace(found[0], f'<inertia ixx="{size}" {rest}/>'))
    folder = read_folder(tmp_path, URDF_YAML)
    spec_of(folder)
    (said,) = folder.account.sentences()
    assert said.startswith("ixy, ixz and iyz of <link base>: impossible with its")
    (tmp_path / "robot.xml").write_text(
        URDF.replace(found[0], '<inertia ixx="-1e-20" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>')
    )
    spec_of(folder := read_folder(tmp_path, URDF_YAML))
    (said,) = folder.account.sentences()
    assert said.startswith("inertia of <link base>: not positive; that of a ball of 2 cm")


STAND = """
<mujoco>{option}
  <worldbody>{floor}
    <body name="top" pos="0 0 0.35"><freejoint/>
      <geom name="top" type="box" size="0.25 0.15 0.03" mass="6" {top}/>
      {legs}
    </body>
  </worldbody>{contact}
  <actuator>{motors}</actuator>
</mujoco>
"""
SIDES = {"fr": "0.2 -0.12", "fl": "0.2 0.12", "rr": "-0.2 -0.12", "rl": "-0.2 0.12"}
STAND_YAML = "nw-robot: 1\nname: stand\nmodel: {file: robot.xml}\n"


def stand(tmp_path, *, floor="", foot="", shin="", top="", contact="", option="", yaml=STAND_YAML):
    """Return a table on four legs whose feet are balls, and the account of its file."""
    legs = "".join(
        f'<body name="leg_{side}" pos="{at} 0"><joint name="hip_{side}" axis="0 1 0" '
        f'range="-40 40" armature="0.01"/><geom name="shin_{side}" type="capsule" '
        f'fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5" {shin}/><geom name="foot_{side}" '
        f'type="sphere" pos="0 0 -0.3" size="0.025" mass="0.05" {foot}/></body>'
        for side, at in SIDES.items()
    )
    motors = "".join(
        f'<position joint="hip_{side}" kp="60" kv="2" forcerange="-30 30"/>' for side in SIDES
    )
    text = STAND.format(
        floor=floor, legs=legs, top=top, contact=contact, option=option, motors=motors
    )
    (tmp_path / "robot.xml").write_text(text)
    folder = read_folder(tmp_path, yaml)
    return spec_of(folder), folder.account, mujoco.MjModel.from_xml_string(text)


def touched(model, ground):
    """Return the geoms of a robot that touch ground, as MuJoCo itself finds contacts."""
    data = mujoco.MjData(model)
    for _ in range(400):
        mujoco.mj_step(model, data)
    pairs = data.contact.geom[: data.ncon].tolist()
    names = [{model.geom(g).name for g in pair} for pair in pairs]
    return {name for pair in names if ground in pair for name in pair - {ground}}


FLOOR = '<geom name="floor" type="plane" size="5 5 .1" {}/>'
PAIRS = "".join(f'<pair geom1="foot_{side}" geom2="floor"/>' for side in SIDES)
APART = "".join(f'<exclude body1="world" body2="leg_{side}"/>' for side in ("fr", "fl"))


@pytest.mark.parametrize(
    "parts",
    [
        {"floor": FLOOR.format(""), "foot": ""},
        {"floor": FLOOR.format('conaffinity="3"'), "foot": 'contype="2" conaffinity="0"'},
        {"floor": FLOOR.format('contype="4"'), "foot": 'contype="0" conaffinity="4"'},
        {
            "floor": FLOOR.format('conaffinity="2"'),
            **dict.fromkeys(("foot", "shin", "top"), 'contype="2" conaffinity="4"'),
        },
        {
            "floor": FLOOR.format('contype="8" conaffinity="8"'),
            "foot": 'contype="1" conaffinity="0"',
            "shin": 'contype="8" conaffinity="0"',
        },
        {
            "floor": FLOOR.format(""),
            "foot": 'contype="0" conaffinity="0"',
            "contact": f"<contact>{PAIRS}</contact>",
        },
        {
            "floor": FLOOR.format(""),
            **dict.fromkeys(("foot", "shin", "top"), 'contype="0" conaffinity="0"'),
            "contact": f"<contact>{PAIRS}</contact>",
        },
        {"floor": FLOOR.format(""), "contact": f"<contact>{APART}</contact>"},
        {
            "floor": f'<body name="ground">{FLOOR.format("")}</body>',
            "contact": '<contact><exclude body1="ground" body2="leg_fr"/></contact>',
        },
    ],
)
def test_what_touches_the_floor_of_the_file_touches_that_of_scenes(tmp_path, parts):
    spec, _, theirs = stand(tmp_path, **parts)
    ours = mujoco.MjSpec.from_string(spec.mjcf)
    add_geometry(ours, FLAT, friction=None)
    model = ours.compile()
    assert touched(model, "ground") == touched(theirs, "floor") != set()
    with World(spec, FLAT) as world:
        world.reset(position=(0.0, 0.0, spec.spawn_height), yaw=0.0)
        for _ in range(50):
            world.step(spec.default_pose)
        touch = {f"leg_{name[-2:]}" for name in touched(theirs, "floor")}
        if len(touch) == 4:  # Else it tips over.
            assert set(spec.feet) == touch
            assert world.foot_contacts.all()


def test_geoms_that_touch_each_other_and_no_ground_stay_solid(tmp_path):
    own = 'contype="2" conaffinity="2"'
    spec, _, theirs = stand(tmp_path, shin=own, foot="")
    model = mujoco.MjModel.from_xml_string(spec.mjcf)
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        masks = model.geom_contype[geom], model.geom_conaffinity[geom]
        assert masks == (theirs.geom(name).contype[0], theirs.geom(name).conaffinity[0])


def test_masks_that_meet_no_ground_are_reported(tmp_path):
    with pytest.raises(RobotError, match="contype and conaffinity 2 and 4, ground has 1 and 1; s"):
        stand(tmp_path, **dict.fromkeys(("foot", "shin", "top"), 'contype="2" conaffinity="4"'))


def test_options_of_the_file_are_said_and_those_of_its_own_are_not(tmp_path):
    option = '<option timestep="0.005" gravity="0 0 -9.81" cone="elliptic"><flag sensor="disable"/>'
    _, account, _ = stand(tmp_path, option=f"{option}</option>")
    (said,) = account.sentences()
    assert said.startswith(
        '<option gravity="0 0 -9.81" cone="elliptic">: all robots are simulated with timestep="0.00'
    )
    assert list(account.passed.values()) == [{"sensor of <option>": None}]


PD = '<position joint="j" kp="60" forcerange="-9 9"/><velocity joint="j" kv="2" forcerange="-9 9"/>'


@pytest.mark.parametrize(
    ("motors", "kp", "kd", "torque", "said"),
    [
        (PD, 60.0, 2.5, 18.0, None),
        ('<position joint="j" kp="60" forcerange="-9 9" armature="0.1" damping="0.2" gear="2"/>',
         240.0, 1.3, 18.0, None),
        ('<position name="p" joint="j" kp="60" forcerange="-9 7"/>', 60.0, 0.5, 9.0,
         "motor 'p': its forcerange is not the same both ways; the larger end is taken"),
        ('<position name="p" joint="j" kp="60" forcerange="-50 50"/>', 60.0, 0.5, 20.0, None),
        ('<position name="p" joint="j" kp="60" ctrlrange="-1 1"/>', 60.0, 0.5, 20.0,
         "motor 'p': it clamps its targets, which is not simulated"),
        ('<position name="p" joint="j" kp="60" gear="-1"/>', 60.0, 0.5, 20.0,
         "motor 'p': its gear turns it the other way, which is not simulated"),
        ('<position name="p" joint="j" kp="60" timeconst="0.1"/>', 60.0, 0.5, 20.0,
         "motor 'p': it has states of its own, which is not simulated"),
        ('<position joint="j" kp="60"/><motor name="t" tendon="t"/>', 60.0, 0.5, 20.0,
         "motor 't': it acts on a tendon, and is left out"),
    ],
)  # fmt: skip
def test_motors_are_what_the_file_says_or_it_is_said(tmp_path, motors, kp, kd, torque, said):
    (tmp_path / "robot.xml").write_text(
        "<mujoco><default><position gear='1'/></default><worldbody><body name='b'><freejoint/>"
        "<geom size='.1' mass='3'/><body name='leg'><joint name='j' axis='0 1 0' range='-1 1' "
        "damping='0.5' armature='0.01' actuatorfrcrange='-20 20'/><geom size='.05' mass='1' "
        "pos='0 0 -.3'/></body></body></worldbody><tendon><fixed name='t'><joint joint='j' "
        f"coef='1'/></fixed></tendon><actuator>{motors}</actuator></mujoco>"
    )
    folder = read_folder(tmp_path, STAND_YAML)
    spec = spec_of(folder)
    assert (spec.kp, spec.torque_limits) == ((kp,), (torque,))
    assert spec.joint_damping == pytest.approx((kd,))
    assert spec.armature == pytest.approx((0.41,) if "armature" in motors else (0.01,))
    assert [each.partition("; line")[0] for each in folder.account.sentences()] == (
        [said] if said else []
    )


FOLLOWS = ("adr", "num", "id", "invweight0", "M0", "contype", "geom1", "geom2")


def test_what_moves_a_robot_is_that_of_mujoco_s_own_compilation(tmp_path):
    """Every array of bodies, joints, geoms, tendons and equalities that is not named here."""
    written(tmp_path)
    text = MJCF.replace('<joint name="wag"', '<joint name="wag" springdamper=".1 1" ref=".1"')
    text = text.replace('name="shin_motor"', 'name="shin_motor" friction=".7 .1 .1" condim="4"')
    text = text.replace('<fixed name="sum"', '<fixed name="sum" stiffness="3" damping="2"')
    (tmp_path / "robot.xml").write_text(text)
    spec = spec_of(read_folder(tmp_path, YAML))
    ours = mujoco.MjModel.from_xml_string(spec.mjcf)
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    kept = [theirs.geom(ours.geom(g).name).id for g in range(ours.ngeom)]
    otherwise = {"geom_group", "geom_rgba", "geom_matid", "geom_contype", "geom_dataid"}
    compared = 0
    for field in dir(theirs):
        array = getattr(theirs, field)
        kind = field.partition("_")[0]
        if kind not in {"body", "jnt", "dof", "geom", "tendon", "eq", "pair", "exclude", "qpos0"}:
            continue
        if not isinstance(array, np.ndarray) or field in otherwise or array.dtype.kind not in "fiu":
            continue
        array = array[kept] if kind == "geom" else array
        if field.endswith(FOLLOWS):
            continue  # Places in other arrays, and what follows from the rest.
        np.testing.assert_allclose(getattr(ours, field), array, rtol=1e-5, atol=1e-8, err_msg=field)
        compared += 1
    assert compared > 60


def test_ground_of_the_file_may_be_a_height_field(tmp_path):
    field = (
        '<geom name="floor" type="hfield" hfield="h" conaffinity="2"/>'
        '</worldbody><asset><hfield name="h" file="no.png"/></asset><worldbody>'
    )
    (tmp_path / "robot.xml").write_text(
        f"<mujoco><worldbody>{field}<body><freejoint/><geom name='a' size='.1' contype='2' "
        "conaffinity='0'/><body><joint name='j'/><geom name='b' size='.1' pos='0 0 -.1' "
        "contype='4' conaffinity='0'/></body></body></worldbody></mujoco>"
    )
    yaml = STAND_YAML + "motors: [{joints: j, kp: 1, kd: 1, torque: 1}]\n"
    folder = read_folder(tmp_path, yaml)
    model = mujoco.MjModel.from_xml_string(spec_of(folder).mjcf)
    assert model.geom("a").contype[0] & 1
    assert "<hfield>" in folder.account.passed[PASSED["hfield"]]


def test_names_are_found_from_the_file_that_includes_and_ends_of_a_package_s_path(tmp_path):
    urdf = tmp_path / "bot_description" / "urdf" / "bot.urdf"
    urdf.parent.mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "bot_description" / "foot.stl")
    for path in (
        "package://bot_description/foot.stl",
        "package://ws/src/bot_description/foot.stl",
        "file:///home/user/ws/bot_description/foot.stl",
        "model://bot_description/foot.stl",
        "$(find bot_description)/foot.stl",
        "../foot.stl",
    ):
        mesh = f'<mesh filename="{path}"/>'
        urdf.write_text(URDF.replace('<sphere radius="0.04"/>', mesh))
        yaml = URDF_YAML.replace("robot.xml", "bot_description/urdf/bot.urdf")
        assert "bot_description/foot.stl" in read_folder(tmp_path, yaml).files
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "robot.xml").write_text('<mujoco><include file="a/one.xml"/></mujoco>')
    (tmp_path / "a" / "one.xml").write_text('<mujoco><include file="b/two.xml"/></mujoco>')
    (tmp_path / "a" / "b" / "two.xml").write_text("<mujoco><compiler/></mujoco>")
    assert "a/b/two.xml" in read_folder(tmp_path, STAND_YAML).files


def test_a_draft_tells_the_fault_of_the_folder_in_which_most_was_found(tmp_path):
    model = tmp_path / "bot" / "mjcf" / "robot.xml"
    model.parent.mkdir(parents=True)
    (tmp_path / "bot" / "meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "bot" / "meshes" / "m.stl")
    model.write_text(
        "<mujoco><compiler meshdir='../meshes'/><asset><mesh name='m' file='m.stl'/></asset>"
        "<worldbody><body name='b'><joint type='ball'/><geom type='mesh' mesh='m'/></body>"
        "</worldbody></mujoco>"
    )
    with pytest.raises(RobotError, match="its top body 'b' has joints that are not free"):
        draft_robot(model)
    # Neither folder gets farther than the other: the one below the mesh may not look for it.
    (tmp_path / "bot" / "meshes" / "m.stl").unlink()
    with pytest.raises(RobotError, match=r"mesh 'meshes/m.stl' is not in the folder"):
        draft_robot(model)


SLIDES = "<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 1 0'/>"
ALONG_Z = "<joint type='slide' axis='0 0 1'/>"
HINGES = "".join(f"<joint axis='{axis}'/>" for axis in ("1 0 0", "0 1 0", "0 0 1"))


def freed(tmp_path, joints, monkeypatch):
    """Return the table with other joints at its root, but for the name of that joint."""
    monkeypatch.setitem(globals(), "STAND", STAND.replace("<freejoint/>", joints))
    spec, _, _ = stand(tmp_path)
    monkeypatch.undo()
    return replace(spec, root_joint="", mjcf=spec.mjcf.replace(spec.root_joint, ""))


@pytest.mark.parametrize("turns", ["<joint type='ball'/>", HINGES])
def test_joints_that_move_the_root_as_a_free_joint_does_are_one(tmp_path, turns, monkeypatch):
    free = freed(tmp_path, "<freejoint/>", monkeypatch)
    assert freed(tmp_path, SLIDES + ALONG_Z + turns, monkeypatch) == free


def test_joints_that_leave_the_root_one_way_less_are_no_free_joint(tmp_path, monkeypatch):
    with pytest.raises(RobotError, match="has joints that are not free"):
        freed(tmp_path, SLIDES + "<joint type='ball'/>", monkeypatch)
