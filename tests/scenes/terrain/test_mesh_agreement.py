"""The same box from every writer and in every variant of OBJ, STL, PLY and GLB: the same triangles.

`written/open3d.*` were written by Open3D 0.20.0 (`write_triangle_mesh`) from the box below.
"""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from nw_base.errors import SceneError
from nw_scenes.mesh_file import inspect_mesh, read_mesh

WRITTEN = Path(__file__).parent / "written"
# A box of 2 x 1 x 0.5 m beside the origin: no axis and no sign can be taken for another.
V = np.array([[x, y, z] for x in (0.25, 2.25) for y in (-0.5, 0.5) for z in (0.125, 0.625)])
F = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
    [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
MIXED = [*QUADS[:3], *F[6:]]


def triangles(mesh):
    """Each triangle's corners to a tenth of a millimetre, the first one least: winding counts."""
    found = set()
    for corners in np.round(mesh.triangles, 4).tolist():
        first = corners.index(min(corners))
        found.add(tuple(tuple(p) for p in corners[first:] + corners[:first]))
    return found


def area(mesh):
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def volume(mesh):
    """Positive where all faces look outwards."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return (a * np.cross(b, c)).sum() / 6


def is_the_box(mesh):
    assert area(mesh) == pytest.approx(7.0, abs=1e-5)
    assert volume(mesh) == pytest.approx(1.0, abs=1e-5)
    used = mesh.vertices[np.unique(mesh.faces)]
    assert used.min(axis=0) == pytest.approx(V.min(axis=0), abs=1e-5)
    assert used.max(axis=0) == pytest.approx(V.max(axis=0), abs=1e-5)
    return True


BOX = triangles(trimesh.Trimesh(V, F, process=False))
_v = "".join("v {} {} {}\n".format(*p) for p in V)


def _f(faces, text="{}"):
    return "".join("f " + " ".join(text.format(i + 1) for i in f) + "\n" for f in faces)


def _own_vertices(text):
    """Every triangle brings its own vertices and counts back to them."""
    return "".join("".join("v {} {} {}\n".format(*V[i]) for i in f) + text for f in F)


OBJ = {
    "plain": _v + _f(F),
    "relative": _v + "".join("f " + " ".join(str(i - 8) for i in f) + "\n" for f in F),
    "relative, interleaved": _own_vertices("f -3 -2 -1\n"),
    "relative, interleaved, with textures": "mtllib a b.mtl\no A\n"
    + _own_vertices("vt 0 0\nf -3/-1 -2/-1 -1/-1\n"),
    "mixed signs": _v + "".join(f"f {f[0] + 1} {f[1] - 8} {f[2] + 1}\n" for f in F),
    "before their vertices": _f(F) + _v,
    "indented": "".join(f"  \t{line}\n" for line in (_v + _f(F)).splitlines()),
    "some indented": _v + _f(F[:6]) + "".join(f"  {line}\n" for line in _f(F[6:]).splitlines()),
    "tabs": (_v + _f(F)).replace(" ", "\t"),
    "CRLF": (_v + _f(F)).replace("\n", "\r\n"),
    "CR": (_v + _f(F)).replace("\n", "\r"),
    "mixed endings": _v.replace("\n", "\r\n") + _f(F[:6]) + _f(F[6:]).replace("\n", "\r\n"),
    "continued": _v + "".join(f"f {a + 1} {b + 1} \\\n {c + 1}\n" for a, b, c in F),
    "continued, CRLF": (_v + "".join(f"f {a + 1} {b + 1} \\\n {c + 1}\n" for a, b, c in F)).replace(
        "\n", "\r\n"
    ),
    "a comment that ends with a backslash": "# C:\\scans\\\n" + _v + _f(F),
    "a comment behind": _v + _f(F).replace("\n", "  # a face\n"),
    "a byte order mark": "\ufeff" + _v + _f(F),
    "no newline at the end": (_v + _f(F)).rstrip(),
    "colours": "".join("v {} {} {} 0.5 0.5 0.5\n".format(*p) for p in V) + _f(F),
    "weights": _v.replace("\n", " 1.0\n") + _f(F),
    "some coloured": _v.replace("\n", " 0.5 0.5 0.5\n", 4) + _f(F),
    "textures and normals": _v + "vt 0 0\nvn 0 0 1\n" + _f(F, "{}/1/1"),
    "normals": _v + "vn 0 0 1\n" + _f(F, "{}//1"),
    "quads": _v + _f(QUADS),
    "quads and triangles": _v + _f(MIXED),
    "the old word": _v + _f(F).replace("f ", "fo "),
    "plus signs and exponents": "".join("v {:+e} {:+e} {:+e}\n".format(*p) for p in V) + _f(F),
}


@pytest.mark.parametrize("variant", OBJ)
def test_every_variant_of_obj_is_the_same_box(tmp_path, variant):
    path = tmp_path / "box.obj"
    path.write_bytes(OBJ[variant].encode())
    mesh, findings = inspect_mesh(path)
    assert is_the_box(mesh)
    assert findings == ()
    if "quads" not in variant:
        assert triangles(mesh) == BOX


def test_a_hurdle_with_relative_indices_stands_where_it_was_modelled(tmp_path):
    """Each object counts back to its own vertices, as some exporters write them."""
    text = ""
    for low, high in (((-3, -3, -0.2), (6, 3, 0)), ((2, -1.5, 0), (2.2, 1.5, 0.2))):
        corners = np.where(V.mean(axis=0) < V, high, low)
        text += "".join("v {} {} {}\n".format(*p) for p in corners)
        text += "".join("f " + " ".join(str(i - 8) for i in f) + "\n" for f in F)
    path = tmp_path / "place.obj"
    path.write_text(text)
    mesh = read_mesh(path)
    assert len(mesh.faces) == 24
    assert mesh.vertices[np.unique(mesh.faces)][:, 2].max() == pytest.approx(0.2)


def _shape(n, radius):
    angles = 2 * np.pi * np.arange(n) / n
    return [(radius(i) * np.cos(a), radius(i) * np.sin(a)) for i, a in enumerate(angles)]


def _comb(teeth):
    """A bar with slots: as many notches as teeth."""
    points = [(0.0, 0.0), (2.0 * teeth - 1, 0.0)]
    for i in reversed(range(teeth)):
        points += [(2.0 * i + 1, 2.0), (2.0 * i, 2.0)]
        if i:
            points += [(2.0 * i, 1.0), (2.0 * i - 1, 1.0)]
    return points


POLYGONS = {
    "L": [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)],
    "arrow of four": [(0, 0), (2, -1), (1, 0), (2, 1)],
    "octagon": _shape(8, lambda _: 1.0),
    "star": _shape(10, lambda i: 1.0 if i % 2 else 0.4),
    "comb": _comb(6),
    "long comb": _comb(60),
    "corners on an edge": [(0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (1, 1), (0, 1)],
    # A hole of 1 x 1 m in 3 x 3 m, joined by a cut that is walked twice, as Blender does it.
    "a hole": [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)],
}


@pytest.mark.parametrize("axes", ["xy", "yz", "zx"])
@pytest.mark.parametrize("name", POLYGONS)
def test_notches_of_polygons_stay_open(tmp_path, name, axes):
    """Against shapely: the triangles cover the polygon, and nothing twice."""
    shapely = pytest.importorskip("shapely")
    points = POLYGONS[name]
    whole = shapely.Polygon(points)
    if name == "a hole":
        whole = shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2)
    for turn in range(len(points)):  # Whichever corner comes first.
        order = points[turn:] + points[:turn]
        rows = [dict(zip(axes, p, strict=True)) for p in order]
        text = "".join(f"v {r.get('x', 0)} {r.get('y', 0)} {r.get('z', 0)}\n" for r in rows)
        path = tmp_path / "floor.obj"
        path.write_text(text + "f " + " ".join(str(i + 1) for i in range(len(points))) + "\n")
        mesh = read_mesh(path)
        place = ["xyz".index(axis) for axis in axes]
        cut = [shapely.Polygon(t) for t in mesh.triangles[:, :, place]]
        assert sum(t.area for t in cut) == pytest.approx(whole.area, rel=1e-9)
        assert shapely.union_all(cut).symmetric_difference(whole).area < 1e-9
        if len(points) > 30:
            break


def test_a_polygon_that_crosses_itself_is_named_with_its_line(tmp_path):
    path = tmp_path / "a.obj"
    points = [(0, 0), (4, 0), (4, 3), (1, -1), (1, 3), (3, -1), (0, 3)]
    path.write_text(
        "".join("v {} {} 0\n".format(*p) for p in points) + "# a face\nf 1 2 3 4 5 6 7\n"
    )
    with pytest.raises(SceneError, match=r"a\.obj:9: a polygon crosses itself; triangulate it"):
        read_mesh(path)


def test_polygons_with_too_many_notches_are_refused_soon(tmp_path):
    points = _shape(4000, lambda i: 1.0 if i % 2 else 0.99999)
    path = tmp_path / "a.obj"
    text = "".join(f"v {x} {y} 0\n" for x, y in points)
    path.write_text(text + ("f " + " ".join(str(i + 1) for i in range(4000)) + "\n") * 100)
    with pytest.raises(SceneError, match="too many notches"):
        read_mesh(path)


def _stl(header=b"box", attribute=0, after=b""):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *V[f].reshape(-1), attribute) for f in F)
    return header.ljust(80, b" ") + struct.pack("<I", len(F)) + body + after


_facets = [
    "facet normal 0 0 0\n outer loop\n"
    + "".join("  vertex {} {} {}\n".format(*V[i]) for i in f)
    + " endloop\nendfacet\n"
    for f in F
]
_ASCII = f"solid a\n{''.join(_facets)}endsolid a\n"
STL = {
    "binary": _stl(),
    "binary that begins with solid": _stl(b"solid scan exported by SolidWorks"),
    "binary with the words of ASCII": _stl(b"solid x\nfacet normal"),
    "binary with attributes": _stl(attribute=0x7FFF),
    "ASCII": _ASCII.encode(),
    "ASCII without a name": _ASCII.replace(" a\n", "\n").encode(),
    "ASCII in capitals": _ASCII.upper().encode(),
    "ASCII, CRLF": _ASCII.replace("\n", "\r\n").encode(),
    "ASCII of two solids": (
        f"solid a\n{''.join(_facets[:5])}endsolid a\nsolid b\n{''.join(_facets[5:])}endsolid b\n"
    ).encode(),
}


@pytest.mark.parametrize("variant", STL)
def test_every_variant_of_stl_is_the_same_box(tmp_path, variant):
    path = tmp_path / "box.stl"
    path.write_bytes(STL[variant])
    mesh, findings = inspect_mesh(path)
    assert triangles(mesh) == BOX
    has_more = variant == "binary with attributes"
    assert [one.code for one in findings] == ["mesh_partly_read"] * has_more


def test_bytes_behind_an_stl_are_told(tmp_path):
    path = tmp_path / "box.stl"
    path.write_bytes(_stl(after=b"\0" * 10))
    mesh, (finding,) = inspect_mesh(path)
    assert triangles(mesh) == BOX
    assert finding.code == "mesh_partly_read"
    assert "10 bytes after the last facet" in finding.message


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (_stl()[:-1], "its 12 facets need 684"),
        (_stl()[:80] + bytes(4) + _stl()[84:], "its header has 0 facets, and 600 bytes follow"),
        (STL["ASCII"].replace(b"  vertex", b"  vertx", 1), "a facet of 2 vertices"),
        (STL["ASCII"][:-40], "a facet does not end"),
        (STL["ASCII"].replace(b"0.25", b"0.2x", 1), r"a\.stl:4: `vertex` is not followed by three"),
    ],
)
def test_an_stl_that_lost_something_is_refused(tmp_path, data, words):
    path = tmp_path / "a.stl"
    path.write_bytes(data)
    with pytest.raises(SceneError, match=words):
        read_mesh(path)


def _ply(
    faces=F, *, order="<", index="vertex_indices", vertex="float", count="uchar", item="int",
    before="", behind="", extra="", cells=b"", data=b"", after=b"",
):  # fmt: skip
    codes = {"uchar": "B", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"ply\nformat {name} 1.0\ncomment a box\n{before}element vertex 8\n"
    head += "".join(f"property {vertex} {axis}\n" for axis in "xyz") + extra
    head += f"element face {len(faces)}\nproperty list {count} {item} {index}\n{behind}end_header\n"
    body = b"".join(struct.pack(order + "3" + codes[vertex], *p) + cells for p in V)
    for f in faces:
        body += struct.pack(order + codes[count] + codes[item] * len(f), len(f), *f)
        body += b"\2" + struct.pack(order + "2f", 1, 2) if behind else b""
    return head.encode() + data + body + after


def _ascii_ply(faces=F, newline="\n"):
    lines = ["ply", "format ascii 1.0", "element vertex 8", "property float x"]
    lines += ["property float y", "property float z", "property uchar red"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += ["{} {} {} 10".format(*p) for p in V]
    lines += [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
    return (newline.join(lines) + newline).encode()


_strip = [i for f in F for i in (*f, -1)]
# A box as one strip of 14 corners.
_one = [2, 6, 0, 4, 5, 6, 7, 2, 3, 0, 1, 5, 3, 7]
PLY = {
    "plain": _ply(),
    "big-endian doubles": _ply(order=">", vertex="double", item="uint"),
    "vertex_index": _ply(index="vertex_index", count="int", item="uint"),
    "short indices": _ply(item="ushort"),
    "colours": _ply(extra="property uchar red\nproperty float quality\n", cells=b"\1" * 5),
    "a list behind": _ply(behind="property list uchar float texcoord\n"),
    "quads": _ply(QUADS),
    "quads and triangles": _ply(MIXED),
    "triangles and quads": _ply(MIXED[::-1]),
    "quads and triangles, a list behind": _ply(
        MIXED, behind="property list uchar float texcoord\n"
    ),
    "quads and triangles, big-endian": _ply(MIXED, order=">"),
    "ASCII": _ascii_ply(),
    "ASCII, CRLF": _ascii_ply(newline="\r\n"),
    "ASCII quads and triangles": _ascii_ply(MIXED),
    "strips": b"",
    "one strip": b"",
}
for _name, _run in (("strips", _strip), ("one strip", _one)):
    PLY[_name] = (
        _ply([]).replace(
            b"element face 0\nproperty list uchar int vertex_indices",
            b"element tristrips 1\nproperty list int int vertex_indices",
        )
        + struct.pack(f"<i{len(_run)}i", len(_run), *_run)
    )  # fmt: skip


@pytest.mark.parametrize("variant", PLY)
def test_every_variant_of_ply_is_the_same_box(tmp_path, variant):
    path = tmp_path / "box.ply"
    path.write_bytes(PLY[variant])
    mesh, findings = inspect_mesh(path)
    assert is_the_box(mesh)
    has_more = variant == "colours"  # And `quality`, which no reader uses.
    assert [one.code for one in findings] == ["mesh_partly_read"] * has_more
    if "quads" not in variant and variant != "one strip":
        assert triangles(mesh) == BOX


def test_what_of_a_file_is_no_triangle_is_told(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ["plain"] + "l 1 2\nl 2 3\np 1\nvp 0.5\nfoo 1\n")
    data = _ply(before="element camera 1\nproperty float view_px\n", data=struct.pack("<f", 1))
    (tmp_path / "a.ply").write_bytes(data)
    mesh, (finding,) = inspect_mesh(tmp_path / "a.obj")
    assert triangles(mesh) == BOX
    assert finding.code == "mesh_partly_read"
    assert "2 lines, 1 lines of curved surfaces, 1 points, 1 unknown lines 'foo'" in finding.message
    mesh, (finding,) = inspect_mesh(tmp_path / "a.ply")
    assert triangles(mesh) == BOX
    assert "1 rows of 'camera'" in finding.message


@pytest.mark.parametrize("file", ["open3d.obj", "open3d.ply", "open3d_ascii.ply", "open3d.stl"])
def test_what_open3d_wrote_is_the_same_box(file):
    assert triangles(read_mesh(WRITTEN / file)) == BOX


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "stl_ascii"])
def test_what_trimesh_writes_is_the_same_box(tmp_path, suffix):
    shape = trimesh.Trimesh(V, F, process=False)
    path = tmp_path / f"box.{suffix.partition('_')[0]}"
    shape.export(path, file_type=suffix)
    assert triangles(read_mesh(path)) == BOX


def test_a_glb_is_turned_from_y_up_and_the_note_says_so():
    """Open3D writes the numbers as they are; in glTF, y is up."""
    mesh, (finding,) = inspect_mesh(WRITTEN / "open3d.glb")
    back = mesh.vertices @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]]).T
    box = trimesh.Trimesh(back, mesh.faces, process=False)
    assert triangles(box) == BOX
    assert finding.code == "mesh_turned"
    assert "(x, -z, y)" in finding.message


def test_poses_of_nodes_and_several_meshes_of_a_glb_are_as_trimesh_has_them(tmp_path):
    scene = trimesh.Scene()
    rotated = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.3, 0.1, 0))
    mirrored = np.diag([-1.5, 1.0, 2.0, 1.0])
    box = trimesh.Trimesh(V, F, process=False)
    scene.add_geometry(box, node_name="a", transform=rotated)
    scene.add_geometry(box, node_name="b", parent_node_name="a", transform=mirrored)
    scene.add_geometry(trimesh.creation.icosphere(1), node_name="c", parent_node_name="b")
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    mesh = read_mesh(tmp_path / "a.glb")
    theirs = trimesh.load_scene(tmp_path / "a.glb").to_mesh()
    x, y, z = theirs.vertices.T
    turned = trimesh.Trimesh(np.stack([x, -z, y], -1), theirs.faces, process=False)
    assert len(mesh.faces) == 12 + 12 + 80
    assert triangles(mesh) == triangles(turned)
    assert volume(mesh) == pytest.approx(1 + 3 + 3 * trimesh.creation.icosphere(1).volume, rel=1e-5)


def _glb(change=lambda _: None):
    indices = np.array(F, "<u2").tobytes()
    points = V.astype("<f4").tobytes()
    told = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(points) + len(indices)}],
    }
    change(told)
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    rest = points + indices
    whole = 12 + 8 + len(text) + 8 + len(rest)
    return (
        struct.pack("<4sIIII", b"glTF", 2, whole, len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(rest), 0x4E4942)
        + rest
    )


def test_a_node_without_triangles_moves_what_hangs_on_it(tmp_path):
    def change(told):
        told["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]})
        told["nodes"] = [{"mesh": 1, "translation": [5, 0, 0], "children": [1]}, {"mesh": 0}]

    (tmp_path / "a.glb").write_bytes(_glb(change))
    mesh, findings = inspect_mesh(tmp_path / "a.glb")
    assert mesh.vertices[:, 0].min() == pytest.approx(5.25)
    assert any("1 primitives of lines" in one.message for one in findings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"]),
            "it needs KHR_draco",
        ),
        (lambda t: t["buffers"][0].update(uri="a.bin"), "lie in 'a.bin'"),
        (lambda t: t["nodes"][0].update(children=[0]), "do not form a tree"),
        (lambda t: t["accessors"][1].update(count=1 << 40), "accessor 1 of"),
        (lambda t: t["accessors"][1].update(sparse={}), "is sparse"),
        (lambda t: t["nodes"].clear(), "IndexError"),
        (lambda t: t["meshes"][0]["primitives"][0].update(mode=0), "no triangles in it, 1 prim"),
        (lambda t: t["nodes"][0].update(scale=[0, 0, 0]), "no face has an area"),
        (lambda t: t.update(nodes=7), "no readable GLB mesh"),
    ],
)
def test_a_glb_that_cannot_be_read_says_why(tmp_path, change, words):
    path = tmp_path / "a.glb"
    path.write_bytes(_glb())
    assert is_the_box_turned(read_mesh(path))
    path.write_bytes(_glb(change))
    with pytest.raises(SceneError, match=words) as caught:
        read_mesh(path)
    assert "a.glb" in str(caught.value)


def is_the_box_turned(mesh):
    assert volume(mesh) == pytest.approx(1.0, abs=1e-5)
    assert mesh.vertices.max(axis=0) == pytest.approx([2.25, -0.125, 0.5])
    return True


def test_a_mesh_at_more_places_than_memory_holds_is_refused(tmp_path):
    def change(told):
        told["meshes"][0]["primitives"] *= 1000
        told["nodes"] = [{"mesh": 0} for _ in range(400)]
        told["scenes"] = [{"nodes": [*range(400)]}]

    (tmp_path / "a.glb").write_bytes(_glb(change))
    with pytest.raises(SceneError, match="decimate it"):
        read_mesh(tmp_path / "a.glb")
