"""Meshes of COLLADA: their triangles, units and places, and what is no such file.

The file is written by hand, by the specification of COLLADA 1.4.1: a square of two polygons below a
node that moves and turns it.
"""

import numpy as np
import pytest

from nw_base.errors import RobotError
from nw_scenes.robots import find_robot
from nw_scenes.robots.collada import as_stl
from nw_scenes.robots.folder import triangles

pytestmark = pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")
DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="millimeter" meter="0.001"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="square"><mesh>
    <source id="points"><float_array id="numbers" count="12">0 0 0 100 0 0 100 50 0 0 50 0
      </float_array><technique_common><accessor source="#numbers" count="4" stride="3">
      <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#points"/></vertices>
    SHAPES
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene"><node id="moved">
    <matrix>0 -1 0 10 1 0 0 20 0 0 1 30 0 0 0 1</matrix>
    <instance_geometry url="#square"/></node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
CORNERS = '<input semantic="VERTEX" source="#corners" offset="0"/>'
TRIANGLES = f'<triangles count="2">{CORNERS}<p>0 1 2 0 2 3</p></triangles>'
POLYGON = f'<polylist count="1">{CORNERS}<vcount>4</vcount><p>0 1 2 3</p></polylist>'
LINES = f'<lines count="1">{CORNERS}<p>0 1</p></lines>'
URDF = """<robot name="block">
  <link name="base">
    <inertial><mass value="2"/>INERTIA</inertial>
    <collision><geometry><mesh filename="square.dae"/></geometry></collision>
  </link>
  <link name="shin">
    <inertial><mass value="1"/>INERTIA</inertial>
    <collision><geometry><box size=".1 .1 .1"/></geometry></collision>
  </link>
  <joint name="knee" type="revolute"><parent link="base"/><child link="shin"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="5"/></joint>
</robot>
""".replace("INERTIA", '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>')


def dae(*shapes, **changes):
    text = DAE.replace("SHAPES", "".join(shapes))
    for old, new in changes.items():
        text = text.replace(old, new)
    return text.encode()


def nested(levels):
    """A node of ten nodes of ten nodes ... of a square."""
    shown = '<instance_geometry url="#square"/>'
    nodes = f'<node id="n0">{shown}</node>'
    for level in range(levels):
        nodes += f'<node id="n{level + 1}">' + f'<instance_node url="#n{level}"/>' * 10 + "</node>"
    text = dae(TRIANGLES).decode().replace(shown, f'<instance_node url="#n{levels}"/>')
    library = f"<library_nodes>{nodes}</library_nodes><library_visual_scenes>"
    return text.replace("<library_visual_scenes>", library).encode()


@pytest.mark.parametrize("shape", [TRIANGLES, POLYGON])
def test_a_square_lies_where_its_node_puts_it_in_metres(shape):
    vertices, faces = triangles(as_stl(dae(shape, LINES)), ".stl")
    # Turned by a quarter about z and moved by 10, 20, 30 mm: (x, y) becomes (10 - y, 20 + x).
    wanted = {(0.01, 0.02), (0.01, 0.12), (-0.04, 0.12), (-0.04, 0.02)}
    assert {tuple(point) for point in np.round(vertices[:, :2], 6).tolist()} == wanted
    assert np.allclose(vertices[:, 2], 0.03)
    assert len(faces) == 2


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (dae(LINES), "no triangles"),
        (dae(TRIANGLES)[:900], "cannot be read"),
        (b"PK\x03\x04", "no XML"),
        (b'<!DOCTYPE x [<!ENTITY a "b">]>' + dae(TRIANGLES), "document type or entities"),
        (dae(TRIANGLES.replace("0 2 3", "0 2 9")), "one of its geometries"),
        (dae(TRIANGLES.replace("0 2 3", "0 2 -1")), "cannot be read"),
        (dae(POLYGON.replace("<vcount>4", "<vcount>2000000000")), "more corners than it has"),
        (dae(TRIANGLES).replace(b'#square"', b'other.dae#square"'), "of another file"),
        (dae(TRIANGLES).replace(b'meter="0.001"', b'meter="inf"'), "no numbers"),
        (dae(TRIANGLES).replace(b'meter="0.001"', b'meter="-1"'), "no numbers"),
        (nested(7), "over 10000 parts"),
    ],
)
def test_what_is_no_mesh_of_collada_says_why(content, why):
    with pytest.raises(ValueError, match=why):
        as_stl(content)


def test_a_robot_may_collide_by_a_mesh_of_collada(tmp_path):
    (tmp_path / "robot.yaml").write_text(
        "nw-robot: 1\nname: block\nmodel: {file: block.urdf}\nfeet: [shin]\n"
        'motors: [{joints: "*", kp: 10, kd: 1}]\n'
    )
    (tmp_path / "block.urdf").write_text(URDF)
    shape = dae(TRIANGLES, TRIANGLES.replace("0 1 2 0 2 3", "0 2 1 0 3 2")).replace(
        b"100 50 0 0 50 0", b"100 50 0 0 50 40"
    )
    (tmp_path / "square.dae").write_bytes(shape)
    spec = find_robot(f"{tmp_path}/").spec
    assert spec.joints == ("knee",)
    (tmp_path / "square.dae").write_bytes(b"<COLLADA/>")
    with pytest.raises(
        RobotError, match=r"block\.urdf:4.*square\.dae.*no triangles.*save it again as STL"
    ):
        find_robot(f"{tmp_path}/")


def test_a_draft_takes_the_folder_in_which_the_meshes_are_that_are_only_seen(tmp_path):
    from nw_eval import api

    (tmp_path / "block" / "urdf").mkdir(parents=True)
    (tmp_path / "block" / "meshes").mkdir()
    seen = (
        '<visual><geometry><mesh filename="package://block/meshes/square.dae"/></geometry></visual>'
    )
    box = '<collision><geometry><box size=".2 .2 .1"/></geometry></collision>'
    mesh = '<collision><geometry><mesh filename="square.dae"/></geometry></collision>'
    model = tmp_path / "block" / "urdf" / "block.urdf"
    model.write_text(URDF.replace(mesh, seen + box))
    (tmp_path / "block" / "meshes" / "square.dae").write_bytes(dae(TRIANGLES))
    assert api.init_robot(model).file == tmp_path / "block" / "robot.yaml"
    (tmp_path / "block" / "robot.yaml").unlink()
    (tmp_path / "block" / "meshes" / "square.dae").unlink()
    assert api.init_robot(model).file == tmp_path / "block" / "urdf" / "robot.yaml"
