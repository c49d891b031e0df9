"""Each field of a mesh file is used, of no effect, or said by name in exactly one finding."""

import json
import struct

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes.mesh_file import inspect_mesh, read_mesh, read_painted

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def said(path):
    """What is said of a file besides that its axes were turned."""
    return [f.message.partition(": ")[2] for f in read_painted(path).findings]


def write_glb(path, change=None, *, behind=b""):
    blob = TRIANGLE.tobytes() + TRIANGLE.tobytes()
    content = {
        "asset": {"version": "2.0", "generator": "x"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "n"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    if change is not None:
        change(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(blob), b"BIN\0") + blob + behind
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
    return path


def setting(place, **values):
    def change(content):
        at = content
        for step in place:
            at = at[step]
        at.update(values)

    return change


LEFT = "only triangles are used; left out: "
PRIMITIVE = ("meshes", 0, "primitives", 0)


@pytest.mark.parametrize(
    "change",
    [
        None,
        setting((), cameras=[{"type": "perspective"}], extras={"mark": 1}),
        setting(("nodes", 0), camera=0, extras={"mark": 1}),
        setting(("materials", 0), doubleSided=True, emissiveFactor=[1, 1, 1], alphaMode="OPAQUE"),
        setting((*PRIMITIVE, "attributes"), NORMAL=0, TEXCOORD_1=0),
        setting((), extensionsUsed=["KHR_materials_unlit", "KHR_lights_punctual"]),
    ],
)
def test_fields_of_a_glb_without_effect_are_passed_over(tmp_path, change):
    assert said(write_glb(tmp_path / "a.glb", change)) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (setting((), mark=1), "not read: mark"),
        (setting(("nodes", 0), mark=1), "not read: mark"),
        (setting(("meshes", 0), mark=1), "not read: mark"),
        (setting(PRIMITIVE, mark=1), "not read: mark"),
        (setting(("materials", 0), mark=1), "not read: mark"),
        (setting((*PRIMITIVE, "attributes"), _MARK=0), "not read: _MARK"),
        (setting((*PRIMITIVE, "attributes"), COLOR_1=0), "not read: COLOR_1"),
        (
            setting(("nodes", 0), extensions={"EXT_mesh_gpu_instancing": {}}),
            "not read: EXT_mesh_gpu_instancing",
        ),
        (setting((), extensionsUsed=["KHR_node_visibility"]), "not read: KHR_node_visibility"),
        (
            setting((), animations=[{}, {}]),
            "not read: 2 animations: nodes stand as they are without",
        ),
        (
            setting(("materials", 0), alphaMode="BLEND"),
            "not read: alphaMode BLEND of 1 materials, which are solid here",
        ),
        (
            setting((), samplers=[{"wrapS": 33071}]),
            "not read: that textures do not repeat (wrapS, wrapT): they do here",
        ),
        (
            setting((), nodes=[{"mesh": 0}, {"mesh": 0}], scenes=[{"nodes": [0]}, {"nodes": [1]}]),
            f"{LEFT}1 nodes with meshes that are not in its default scene",
        ),
        (
            setting(("nodes", 0), skin=0),
            "only triangles are used; left out: 1 skins (bodies stand as they were modelled)",
        ),
        (
            setting(PRIMITIVE, targets=[{"POSITION": 0}]),
            "only triangles are used; left out: 1 morph targets",
        ),
    ],
)
def test_fields_of_a_glb_that_are_not_read_are_said_once(tmp_path, change, words):
    assert said(write_glb(tmp_path / "a.glb", change)) == [words]


def test_a_further_part_and_an_extension_that_is_needed_are_said(tmp_path):
    part = struct.pack("<I4s", 4, b"MARK") + b"1234"
    assert said(write_glb(tmp_path / "a.glb", behind=part)) == [
        "not read: a part b'MARK' of 4 bytes"
    ]
    change = setting((), extensionsRequired=["KHR_node_visibility"])
    with pytest.raises(SceneError, match="it needs KHR_node_visibility"):
        read_mesh(write_glb(tmp_path / "b.glb", change))


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OBJ + "g a\no b\ns 1\nvn 0 0 1\nlod 2\n", []),
        (OBJ + "l 1 2\np 1\n", ["only triangles are used; left out: 1 lines, 1 points"]),
        (OBJ + "mark 1\n", ["only triangles are used; left out: 1 unknown lines 'mark'"]),
        (OBJ + "curv 0 1 1 2\n", ["only triangles are used; left out: 1 lines of curved surfaces"]),
        (OBJ.replace("v 1 0 0", "v 1 0 0 0.5"), ["not read: the weight of 1 vertices"]),
        (OBJ.replace("v 1 0 0", "v 1 0 0 1.0"), []),
        (
            OBJ.replace("v 1 0 0", "v 1 0 0 .2 .3 .4"),
            ["not read: colours of vertices, which not all vertices have"],
        ),
        (
            "usemtl red\n" + OBJ,
            ["not read: 1 materials that no library has, white here: red"],
        ),
    ],
)
def test_lines_of_an_obj_are_used_passed_over_or_said(tmp_path, text, words):
    (tmp_path / "a.obj").write_text(text)
    assert said(tmp_path / "a.obj") == words


@pytest.mark.parametrize(
    ("line", "is_said"),
    [
        ("Ka 1 1 1", False),
        ("Ns 10", False),
        ("d 1.0", False),
        ("Tr 0", False),
        ("# mark", False),
        ("d 0.5", True),
        ("Tr 0.5", True),
        ("map_d a.png", True),
        ("disp a.png", True),
        ("mark 1", True),
        ("map_Kd -s 2 2 1 a.png", True),
    ],
)
def test_lines_of_an_mtl_are_passed_over_or_said(tmp_path, line, is_said):
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "a.mtl").write_text(f"newmtl red\nKd 1 0 0\n{line}\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl red\n" + OBJ)
    assert said(tmp_path / "a.obj") == ([f"not read: of a.mtl: {line}"] if is_said else [])


def ply(*, vertex=(), face=(), comments=(), elements=()):
    lines = ["ply", "format ascii 1.0", *comments, "element vertex 3"]
    lines += [f"property float {name}" for name in ("x", "y", "z", *vertex)]
    lines += ["element face 1", "property list uchar int vertex_indices"]
    lines += [f"property float {name}" for name in face]
    lines += [line for name in elements for line in (f"element {name} 1", "property int k")]
    rows = [" ".join([*map(str, row), *("0.5" for _ in vertex)]) for row in TRIANGLE.tolist()]
    rows += [" ".join(["3 0 1 2", *("0.5" for _ in face)]), *("4" for _ in elements)]
    return "\n".join([*lines, "end_header", *rows, ""])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"vertex": ("nx", "ny", "nz", "red", "green", "blue", "alpha")}, []),
        ({"vertex": ("s", "t")}, []),
        ({"comments": ("comment made: by hand", "comment units: m", "comment plain words")}, []),
        (
            {"vertex": ("confidence", "red")},
            ["not read: properties of vertex that are not read: confidence, red"],
        ),
        ({"face": ("mark",)}, ["not read: properties of face that are not read: mark"]),
        (
            {"face": ("red", "green", "blue")},
            ["not read: properties of face that are not read: red, green, blue"],
        ),
        ({"comments": ("obj_info scale=2",)}, ["not read: comment that is not read: scale=2"]),
        ({"elements": ("edge",)}, ["only triangles are used; left out: 1 rows of 'edge'"]),
    ],
)
def test_parts_of_a_ply_are_used_passed_over_or_said(tmp_path, parts, words):
    (tmp_path / "a.ply").write_text(ply(**parts))
    if words and "face that are not read: red" in words[0]:
        # Colours of faces are in the pool of names that surfaces alone pass over.
        assert inspect_mesh(tmp_path / "a.ply")[1] == ()
    assert said(tmp_path / "a.ply") == words


def test_a_ply_without_faces_is_called_a_point_cloud(tmp_path):
    text = ply(vertex=("red", "green", "blue")).replace("element face 1", "element face 0")
    (tmp_path / "a.ply").write_text(text.rsplit("3 0 1 2", 1)[0])
    with pytest.raises(SceneError, match=r"a point cloud: 3 points and no faces.*export the scan"):
        read_mesh(tmp_path / "a.ply")


def stl(normal=(0, 0, 1), attribute=0, head=b""):
    row = struct.pack("<3f", *normal) + TRIANGLE.tobytes() + struct.pack("<H", attribute)
    return head.ljust(80) + struct.pack("<I", 1) + row


def test_attributes_headers_and_normals_of_an_stl_are_said(tmp_path):
    against = "not read: the normals of 1 of 1 facets, which contradict the order of their corners"
    for content, words in (
        (stl(), []),
        (stl(normal=(0, 0, 0)), []),
        (stl(attribute=9), ["not read: the attributes of 1 facets, such as colours"]),
        (stl(head=b"COLOR=\1\2\3\4"), ["not read: the colour in its header"]),
        (stl(normal=(0, 0, -1)), [against]),
    ):
        (tmp_path / "a.stl").write_bytes(content)
        assert said(tmp_path / "a.stl") == words
    text = "solid a\nfacet normal 0 0 {}\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    text += "endloop\nendfacet\nendsolid a\n"
    (tmp_path / "a.stl").write_text(text.format(1))
    assert said(tmp_path / "a.stl") == []
    (tmp_path / "a.stl").write_text(text.format(-1))
    assert said(tmp_path / "a.stl") == [against]
    (tmp_path / "a.stl").write_text(text.format(1).replace("outer", "mark 3\nouter"))
    assert said(tmp_path / "a.stl") == ["only triangles are used; left out: 1 unknown lines 'mark'"]


def test_files_of_other_formats_are_called_what_they_are(tmp_path):
    pointer = b"version https://git-lfs.github.com/spec/v1\n"
    for name, content, why in (
        ("a.glb", pointer, "a Git LFS pointer, not the file itself; run `git lfs pull`"),
        ("a.obj", pointer, "a Git LFS pointer"),
        ("a.stl", b"\x1f\x8b\x08", "compressed with gzip"),
        ("a.gltf", b"{}", "glTF that lies in several files; pack it into one file"),
        ("a.fbx", b"Kaydara FBX Binary", "an FBX scene; convert it"),
        ("a.usd", b"PXR-USDC", "a USD stage; give it as .usdz"),
        ("a.dae", b"<?xml version", "XML, such as COLLADA; convert it"),
        ("a.las", b"LASF", "a LAS point cloud; give its points"),
        ("a.ksplat", b"\0\1\0", "a Gaussian splat, which has no surface"),
        ("a.xyz", b"1 2 3", r"no format that is read here; give \.glb, \.obj"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match=why):
            read_mesh(tmp_path / name)
    with pytest.raises(SceneError, match=r"a folder; give a file in it: a\.glb, a\.obj, a\.stl"):
        read_mesh(tmp_path)


@pytest.mark.parametrize(
    ("head", "unit"),
    [
        ("# units: mm\n", "mm"),
        ("# Unit = centimeters\n", "cm"),
        ("# units in feet\n", "ft"),
        ("# a unit of the army\n", None),
        ("# units: mm\n# units: cm\n", None),
        ("", None),
    ],
)
def test_the_unit_that_a_comment_names_is_known(tmp_path, head, unit):
    (tmp_path / "a.obj").write_text(head + OBJ)
    assert read_painted(tmp_path / "a.obj").unit == unit
