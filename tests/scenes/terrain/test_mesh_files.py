"""Mesh files as strangers write them."""

import numpy as np
import pytest
import trimesh

from nw_base.errors import SceneError
from nw_scenes.mesh_file import read_mesh

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def area(mesh):
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(normal, axis=1).sum() / 2


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_every_format_gives_the_same_surface(tmp_path, suffix):
    solid = trimesh.creation.box((1, 2, 3))
    solid.apply_translation((0.1, 0.2, 0.3))
    solid.export(tmp_path / f"a.{suffix}")
    mesh = read_mesh(tmp_path / f"a.{suffix}")
    assert len(mesh.faces) == 12
    assert area(mesh) == pytest.approx(22.0)
    assert mesh.vertices.min(axis=0) == pytest.approx([-0.4, -0.8, -1.2])


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_both_forms_of_ply_are_read(tmp_path, encoding):
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "a.ply", encoding=encoding)
    assert area(read_mesh(tmp_path / "a.ply")) == pytest.approx(6.0)


def test_polygons_negative_indices_and_texture_indices_are_understood(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(QUAD + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//1 -3//1 -2//1\n")
    assert area(read_mesh(path)) == pytest.approx(1.5)


def test_material_files_are_not_opened(tmp_path, monkeypatch):
    (tmp_path / "evil.mtl").write_text("newmtl a\nmap_Kd texture.png\n")
    path = tmp_path / "a.obj"
    path.write_text("mtllib evil.mtl\n" + QUAD + "usemtl a\nf 1 2 3\n")
    from pathlib import Path

    opened = []
    original = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, *a, **k: (opened.append(self.name), original(self, *a, **k))[1]
    )
    read_mesh(path)
    assert set(opened) == {"a.obj"}


def test_scale_multiplies_coordinates(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(QUAD + "f 1 2 3 4\n")
    assert area(read_mesh(path, scale=(2, 2, 2))) == pytest.approx(4.0)


def test_faces_without_area_are_left_out(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(QUAD + "f 1 2 3\nf 1 1 2\n")
    assert len(read_mesh(path).faces) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "nothing there"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "coordinate is 1e"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"bad\.obj:4: a face names vertex 9, there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face has an area"),
        ("v 0 0 zero\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", r"bad\.obj:1: `v` is not followed by three"),
    ],
)
def test_bad_files_are_named_errors(tmp_path, text, words):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(SceneError, match=words) as error:
        read_mesh(path)
    assert "bad.obj" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_noise_is_not_a_mesh(tmp_path, suffix):
    path = tmp_path / f"noise.{suffix}"
    path.write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(SceneError, match="noise"):
        read_mesh(path)


def test_a_missing_file_and_a_strange_suffix_are_named(tmp_path):
    with pytest.raises(SceneError, match="cannot be read"):
        read_mesh(tmp_path / "none.obj")
    with pytest.raises(SceneError, match="pack it into one file"):
        read_mesh(tmp_path / "a.gltf")
    with pytest.raises(SceneError, match="no format that is read here"):
        read_mesh(tmp_path / "a.xyz")


PLY = """\
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
4 0 1 2 3
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("1 0 0\n", "1 0\n"), r"a\.ply:11: a vertex row does not have the numbers"),
        (("4 0 1 2 3", "4 0 1"), r"a\.ply:14: a face row does not have the numbers"),
        (("4 0 1 2 3\n", ""), r"a\.ply: 1 face rows are said, 0 are there"),
        (("4 0 1 2 3", "4 0 1 2 x"), r"a\.ply:14: a face row does not hold numbers"),
        (("4 0 1 2 3", "4 0 1 2 4"), "a face names vertex 4 of 4"),
        (
            ("element vertex 4", "element vertex 900000000"),
            "a.ply:3: 900000000 vertex rows; dec",
        ),
        (("element vertex 4", "element vertex -4"), "a.ply:3: header line not understood"),
        (("element face 1", "element edge 1"), "a point cloud: 4 points and no faces"),
    ],
)
def test_a_ply_that_does_not_keep_its_promise_is_a_named_error(tmp_path, change, words):
    assert change[0] in PLY
    path = tmp_path / "a.ply"
    path.write_text(PLY.replace(*change))
    with pytest.raises(SceneError, match=words):
        read_mesh(path)


def test_the_parser_writes_nothing_of_its_own_to_the_screen(tmp_path, capfd):
    path = tmp_path / "a.ply"
    path.write_text(PLY.replace("element face", "comment TextureFile x.png\nelement face"))
    assert area(read_mesh(path)) == pytest.approx(1.0)
    (tmp_path / "a.stl").write_text(
        "solid a\nfacet normal a b c\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendfacet\n"
        "endsolid\n"
    )
    assert area(read_mesh(tmp_path / "a.stl")) == pytest.approx(0.5)
    assert capfd.readouterr().err == ""


def test_a_name_that_no_file_can_have_is_named(tmp_path):
    with pytest.raises(SceneError, match="cannot be read"):
        read_mesh(tmp_path / f"{'x' * 300}.obj")
