"""A scan in its file's axes and unit becomes a scene in metres, with its colours and a trail."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.transformations import rotation_matrix
from twin_parts import blobs, grid

from nw_base.errors import SceneError, UsageError
from nw_scenes.folder import load_folder
from nw_scenes.mesh_file import read_painted
from nw_sim.catalogue import inspect_scene
from nw_splat.files import read_splat, write_splat
from nw_splat.gaussians import SH0
from nw_twin.place import moved_points
from nw_twin.scans.scan import ScanOptions, import_scan
from nw_twin.verbs.scenes import scan_lines

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
RED, BLUE = (200, 40, 30), (30, 60, 210)


def picture():
    """A texture, red on its left half and blue on its right."""
    image = Image.new("RGB", (64, 32), RED)
    image.paste(BLUE, (32, 0, 64, 32))
    return image


def ground(*, step=0.1):
    """A sheet of 4 x 2 m as a scan has it, with a step from x = 2.5 m on; z up, metres."""
    points, faces = grid((-0.5, -1, 0), (4, 0, 0), (0, 2, 0), (40, 20))
    points[points[:, 0] > 2.49, 2] = step
    uv = np.stack([(points[:, 0] + 0.5) / 4, (points[:, 1] + 1) / 2], -1)
    return points, faces, uv


def scanned(points, *, texture=None):
    _, faces, uv = ground()
    visual = None
    if texture is not None:
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=texture)
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(points, faces, process=False, visual=visual)


def colours_of(folder):
    """World points (N, 3) of a scene's Gaussians, and their colours (N, 3), 0 to 1."""
    scene = load_folder(folder)
    gaussians = read_splat(scene.splat.path)
    return moved_points(scene.T_world_splat, gaussians.means), 0.5 + SH0 * gaussians.sh[:, 0]


def errors_of(folder):
    found = inspect_scene(str(folder)).findings
    return [each.code for each in found if each.severity == "error"]


def test_a_textured_glb_in_centimetres_becomes_a_scene_that_looks_like_it(tmp_path, ended):
    points, _, _ = ground()
    scanned(100 * points @ Y_UP.T, texture=picture()).export(tmp_path / "scan.glb")
    words = ("--unit", "cm", "--gaussians", "4000", "--trail", "0,0", "1.4,0", "2.7,0")
    code, printed = ended(
        "scenes", "import", tmp_path / "scan.glb", "--out", tmp_path / "mine", *words
    )
    said = printed.out
    assert code == 0, said
    assert "1,600 triangles, 4 x 2 x 0.1 m" in said
    assert "up is +y of the file" in said
    assert f"ready: nw-eval scenes check {tmp_path / 'mine'}" in said
    scene = load_folder(tmp_path / "mine")
    assert np.allclose(scene.static_mesh.vertices.min(axis=0), (-0.5, -1, 0), atol=1e-4)
    assert np.allclose(scene.trail, [[1.4, 0, 0], [2.7, 0, 0.1]], atol=2e-3)
    assert errors_of(tmp_path / "mine") == []
    at, colours = colours_of(tmp_path / "mine")
    left, right = at[:, 0] < 1.4, at[:, 0] > 1.6
    assert np.abs(colours[left] - np.array(RED) / 255).max() < 0.05
    assert np.abs(colours[right] - np.array(BLUE) / 255).max() < 0.05
    assert abs(at[:, 2] - np.where(at[:, 0] > 2.5, 0.1, 0.0)).max() < 0.1


def test_gaussians_are_fine_near_the_trail_and_wide_far_from_it(tmp_path):
    points, faces = grid((-2, -2, 0), (32, 0, 0), (0, 4, 0), (80, 10))
    mesh = trimesh.Trimesh(points, faces, process=False)
    mesh.visual.vertex_colors = np.tile(np.uint8(RED), (len(points), 1))
    mesh.export(tmp_path / "long.ply")
    options = ScanOptions(gaussians=6000, trail=((0.0, 0.0), (2.0, 0.0)))
    import_scan(tmp_path / "long.ply", tmp_path / "mine", options)
    gaussians = read_splat(tmp_path / "mine" / "splat.ply")
    at, width = gaussians.means[:, 0], np.exp(gaussians.log_scales[:, 0])
    near, far = (at > -1) & (at < 3), (at > 24) & (at < 28)
    assert near.sum() / far.sum() == pytest.approx((24 / 3) ** 2, rel=0.3)
    # As many lie over each other here as there.
    covers = [np.square(width[part]).sum() for part in (near, far)]
    assert covers[0] == pytest.approx(covers[1], rel=0.1)


def test_a_texture_of_an_obj_is_read_from_inside_its_folder_only(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    picture().save(tmp_path / "outside.png")
    picture().save(folder / "own.png")
    points, _, _ = ground()
    plain = scanned(points, texture=picture()).export(file_type="obj").replace("mtllib ", "#")
    for name, texture in (("in", "own.png"), ("out", "../outside.png"), ("gone", "/etc/none.png")):
        (folder / f"{name}.mtl").write_text(f"newmtl material_0\nKd 1 1 1\nmap_Kd {texture}\n")
        (folder / f"{name}.obj").write_text(f"mtllib {name}.mtl\n{plain}")
    inside = read_painted(folder / "in.obj")
    assert inside.findings == ()
    assert any(one.texture is not None for one in inside.materials)
    for name, why in (("out", r"`\.\.`"), ("gone", "absolute")):
        read = read_painted(folder / f"{name}.obj")
        assert all(one.texture is None for one in read.materials)
        (found,) = read.findings
        assert why.replace("\\", "") in found.message
    import_scan(folder / "in.obj", tmp_path / "mine", ScanOptions(gaussians=2000))
    at, colours = colours_of(tmp_path / "mine")
    assert np.abs(colours[at[:, 0] > 1.7] - np.array(BLUE) / 255).max() < 0.05


def test_colours_of_vertices_and_of_texcoord_come_through_a_ply(tmp_path):
    points, faces, uv = ground()
    mesh = scanned(points)
    mesh.visual.vertex_colors = np.where(points[:, :1] > 1.5, BLUE, RED).astype(np.uint8)
    mesh.export(tmp_path / "shaded.ply")
    picture().save(tmp_path / "own.png")
    rows = [f"{x} {y} {z}" for x, y, z in points]
    rows += [
        f"3 {a} {b} {c} 6 " + " ".join(str(part) for part in uv[[a, b, c]].ravel())
        for a, b, c in faces
    ]
    head = (
        "ply\nformat ascii 1.0\ncomment TextureFile own.png\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
    )
    (tmp_path / "laid.ply").write_text(head + "\n".join(rows) + "\n")
    for name in ("shaded", "laid"):
        import_scan(tmp_path / f"{name}.ply", tmp_path / name, ScanOptions(gaussians=2000))
        at, colours = colours_of(tmp_path / name)
        assert np.abs(colours[at[:, 0] > 1.7] - np.array(BLUE) / 255).max() < 0.05, name
        assert np.abs(colours[at[:, 0] < 1.3] - np.array(RED) / 255).max() < 0.05, name


def test_a_face_of_a_coloured_ply_that_names_no_vertex_is_an_error(tmp_path):
    head = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 9 9 9\n1 0 0 9 9 9\n0 1 0 9 9 9\n"
    )
    for corner in (-7, 3):
        (tmp_path / "wrong.ply").write_text(f"{head}3 0 1 {corner}\n")
        with pytest.raises(SceneError, match=f"a face names vertex {corner} of 3"):
            read_painted(tmp_path / "wrong.ply")


def test_a_texture_that_is_no_picture_is_said_and_the_rest_is_made(tmp_path):
    points, _, _ = ground()
    scanned(points @ Y_UP.T, texture=picture()).export(tmp_path / "scan.glb")
    stream = io.BytesIO()
    picture().save(stream, "PNG")
    whole = (tmp_path / "scan.glb").read_bytes()
    place = whole.index(b"\x89PNG")
    (tmp_path / "scan.glb").write_bytes(whole[:place] + b"%!PS" + whole[place + 4 :])
    written = import_scan(tmp_path / "scan.glb", tmp_path / "mine", ScanOptions(gaussians=1000))
    assert any("texture 1 left out: no picture" in line for line in written.lines)
    _, colours = colours_of(tmp_path / "mine")
    assert np.abs(colours - 1.0).max() < 0.05


def test_up_is_by_the_planes_of_a_mesh_where_its_format_contradicts_them(tmp_path):
    points, _, _ = ground()
    scanned(points @ Y_UP.T).export(tmp_path / "y-up.stl")
    written = import_scan(tmp_path / "y-up.stl", tmp_path / "y")
    assert "up is +y of the file" in "\n".join(written.lines)
    assert errors_of(written.folder) == []
    scanned(points).export(tmp_path / "z-up.glb")
    written = import_scan(tmp_path / "z-up.glb", tmp_path / "z")
    assert "up is +z of the file: 97 % of its area faces along it" in "\n".join(written.lines)
    assert any("its format has +y up: the planes" in line for line in written.lines)
    assert written.fault is None
    written = import_scan(tmp_path / "z-up.glb", tmp_path / "wall", ScanOptions(up="+y"))
    assert any("and what stands on them, up is +z (" in line for line in written.lines)
    assert "no course: a robot fits nowhere" in written.fault


@pytest.mark.parametrize("degrees", [14, 35])
def test_a_scan_whose_planes_agree_is_laid_level_whatever_its_axes_are(tmp_path, degrees):
    mesh = scanned(ground()[0])
    mesh.apply_transform(rotation_matrix(np.radians(degrees), [0.3, 1, 0]))
    mesh.export(tmp_path / "scan.ply")
    written = import_scan(tmp_path / "scan.ply", tmp_path / "mine")
    assert written.fault is None
    assert any(f", {degrees}.0 degrees from +z: " in line for line in written.lines)
    scene = load_folder(tmp_path / "mine")
    assert np.abs(scene.trail[:, 2] - scene.spawn.position[2]).max() < 0.11
    heights = np.sort(scene.static_mesh.vertices[:, 2])
    assert np.ptp(heights) == pytest.approx(0.1, abs=1e-3)  # The step, and nothing else.


def test_a_scan_of_one_slope_is_not_ready_until_somebody_says_which_way_is_up(tmp_path):
    points, faces = grid((-0.5, -1, 0), (4, 0, 0), (0, 2, 0), (40, 20))
    for degrees in (14, 35):
        turn = rotation_matrix(np.radians(degrees), [0.3, 1, 0])
        mesh = trimesh.Trimesh(moved_points(turn, points), faces, process=False)
        mesh.export(tmp_path / "scan.ply")
        written = import_scan(tmp_path / "scan.ply", tmp_path / f"mine{degrees}")
        assert "degrees only: within 20 degrees of " in written.fault
        assert f"nw-eval scenes level {tmp_path / f'mine{degrees}'}" in scan_lines(written)
    told = import_scan(tmp_path / "scan.ply", tmp_path / "told", ScanOptions(up="+z"))
    assert "the ground at the start is inclined by 35 degrees: level the floor" in told.fault


def test_a_scan_on_a_map_is_moved_to_the_origin_and_one_of_another_unit_is_not_taken(tmp_path):
    points, _, _ = ground()
    text = scanned(points + np.array([448265.0, 5411933.0, 312.0])).export(
        file_type="obj", digits=9
    )
    (tmp_path / "map.obj").write_text(text)
    written = import_scan(tmp_path / "map.obj", tmp_path / "mine")
    assert any(", 5411933, 312) m subtracted" in line for line in written.lines)
    assert errors_of(tmp_path / "mine") == []
    scanned(1000 * points).export(tmp_path / "mm.ply")
    with pytest.raises(SceneError, match=r"mm\.ply: 4e\+03 x 2e\+03 x 100 m .* is not m"):
        import_scan(tmp_path / "mm.ply", tmp_path / "large")
    assert not (tmp_path / "large").exists()
    import_scan(tmp_path / "mm.ply", tmp_path / "large", ScanOptions(unit="mm"))
    assert errors_of(tmp_path / "large") == []


def test_a_robot_without_a_policy_is_refused_with_the_command_that_writes_its_suite(tmp_path):
    with pytest.raises(UsageError, match=r"no policy of the robot 'b2'.*scenes check SCENE"):
        import_scan(tmp_path / "scan.glb", tmp_path / "mine", ScanOptions(robot="b2"))
    assert not (tmp_path / "mine").exists()


def test_a_proposed_trail_is_on_even_ground_away_from_the_rim(tmp_path):
    points, _, _ = ground(step=0.6)
    scanned(points).export(tmp_path / "wall.ply")
    import_scan(tmp_path / "wall.ply", tmp_path / "mine")
    scene = load_folder(tmp_path / "mine")
    way = np.vstack([scene.spawn.position, scene.trail])
    assert np.abs(way[:, 2]).max() < 1e-3
    assert way[:, 0].max() <= 2.5 - 0.5
    assert errors_of(tmp_path / "mine") == []


def uneven():
    """Points on a mesh that lies otherwise after every turn by right angles but one."""
    points, _, _ = ground()
    return points + np.array([0.7, 0.4, 0.3])


def test_a_splat_of_the_same_app_is_laid_on_its_mesh_by_one_transform(tmp_path):
    points = uneven()
    scanned(points @ Y_UP.T).export(tmp_path / "app.glb")
    # The mesh has +y up; the Gaussians, in the axes of a PLY, have it down.
    write_splat(tmp_path / "app.spz", blobs(points @ Y_UP.T * (1, -1, -1)))
    written = import_scan(
        tmp_path / "app.glb", tmp_path / "mine", ScanOptions(splat=tmp_path / "app.spz")
    )
    assert "splat: (x, y, z) of it is (x, -y, -z) of the mesh" in "\n".join(written.lines)
    scene = load_folder(tmp_path / "mine")
    at = moved_points(scene.T_world_splat, read_splat(scene.splat.path).means)
    mesh = np.sort(scene.static_mesh.vertices, axis=0)
    assert np.abs(np.sort(at, axis=0) - mesh).max() < 2e-3


def test_a_splat_of_another_place_is_refused_and_a_matrix_lays_it(tmp_path):
    points = uneven()
    scanned(points).export(tmp_path / "app.ply")
    write_splat(tmp_path / "far.ply", blobs(2.0 * points + 5.0))
    with pytest.raises(SceneError, match=r"no turn by right angles .*; give the 4 x 4 matrix"):
        import_scan(
            tmp_path / "app.ply", tmp_path / "mine", ScanOptions(splat=tmp_path / "far.ply")
        )
    matrix = tmp_path / "T.txt"
    matrix.write_text("[[0.5, 0, 0, -2.5], [0, 0.5, 0, -2.5], [0, 0, 0.5, -2.5], [0, 0, 0, 1]]")
    options = ScanOptions(splat=tmp_path / "far.ply", splat_transform=matrix)
    written = import_scan(tmp_path / "app.ply", tmp_path / "mine", options)
    assert "splat laid by T.txt: half of its Gaussians lie within 0.0" in "\n".join(written.lines)
    for far in ("1 0 0 500  0 1 0 0  0 0 1 0  0 0 0 1", "2 0 0 5  0 2 0 5  0 0 2 5  0 0 0 1"):
        matrix.write_text(far)  # Half a kilometre aside, or the wrong way.
        with pytest.raises(SceneError, match=r"T\.txt: it lays half of the Gaussians"):
            import_scan(tmp_path / "app.ply", tmp_path / "other", options)
    matrix.write_text("1 0 0 0 0 1 0 0 0 0 2 0 0 0 0 1")
    with pytest.raises(SceneError, match=r"T\.txt"):
        import_scan(tmp_path / "app.ply", tmp_path / "other", options)


def test_what_cannot_be_is_refused_by_name_and_nothing_is_left(tmp_path):
    points, _, _ = ground()
    scanned(points).export(tmp_path / "scan.ply")
    (tmp_path / "there").mkdir()
    for source, out, options, why in (
        ("scan.ply", "there", {}, "is there already"),
        ("scan.ply", "new", {"cell": 0.1}, "--cell is of elevation maps"),
        ("scan.ply", "new", {"black": 0.1, "no_data": 3}, "--black and --no-data are of elevation"),
        ("map.png", "new", {"up": "+y", "gaussians": 9000}, "--up and --gaussians are of meshes"),
        ("map.tif", "new", {"unit": "cm"}, "--unit is of meshes: an elevation map has its height"),
        ("scan.ply", "new", {"splat_transform": tmp_path / "T"}, "--splat-transform is of a splat"),
        ("scan.ply", "new", {"splat": tmp_path / "s.ply", "gaussians": 9}, "leave out --splat"),
        ("scan.ply", "new", {"name": ""}, "name ''"),
        ("scan.ply", "new/deep", {"splat": tmp_path / "none.ply"}, "none.ply: No such file"),
        ("scan.ply", "none/..", {}, "there is no .*none; write the path without"),
        ("scan.ply", "scan.ply/x", {}, "scan.ply is not a folder"),
        ("scan.ply", "new", {"trail": ((0.0, 0.0),)}, "--trail has 1 points"),
        ("scan.ply", "new", {"trail": ((0.0, 0.0), (9.0, 0.0))}, "waypoint 0 at .* no ground"),
        ("scan.ply", "new", {"name": "a b"}, "name 'a b'"),
        ("scan.xyz", "new", {}, "no format that is read here"),
    ):
        with pytest.raises((SceneError, UsageError), match=why):
            import_scan(tmp_path / source, tmp_path / out, ScanOptions(**options))
    assert {path.name for path in tmp_path.iterdir()} == {"scan.ply", "there"}


def glb_changed(path, **changes):
    """Write a scan as a GLB; `changes` are made to what its JSON has by each name."""
    scanned(ground()[0] @ Y_UP.T, texture=picture()).export(path)
    whole = path.read_bytes()
    (length,) = struct.unpack_from("<I", whole, 12)
    content, rest = json.loads(whole[20 : 20 + length]), whole[20 + length :]
    for name, change in changes.items():
        content[name] = change(content[name])
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(b"glTF" + head + text + rest)
    return path


def many(count, **more):
    """A change that repeats the only entry of a list, each with a number of its own under a key."""
    return lambda old: [{**old[0], **dict.fromkeys(more, i)} for i in range(count)]


def primitives(count):
    return lambda old: [{"primitives": many(count, material=0)(old[0]["primitives"])}]


def textured(count):
    return lambda _: [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}} for i in range(count)
    ]


def viewed(**view):
    """A change of the third view of a buffer, which is the picture's."""
    return lambda old: [*old[:2], {**old[2], **view}, *old[3:]]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"materials": many(2600), "meshes": primitives(2600)}, "over 2560 materials"),
        (
            {
                "images": many(300),
                "textures": lambda _: [{"source": i} for i in range(300)],
                "materials": textured(300),
                "meshes": primitives(300),
            },
            "over 256 textures, one over 128 MB, or all larger than the file",
        ),
        ({"textures": lambda _: [{"source": 7}]}, "no readable GLB mesh: IndexError"),
        ({"bufferViews": viewed(byteOffset=-5)}, "the picture 0 lies at bytes -5 to "),
        ({"bufferViews": viewed(byteLength=10**12)}, "the picture 0 lies at bytes .* cut short"),
        ({"nodes": lambda old: [{**old[0], "rotation": [0, 0, 0, 0]}]}, "rotation .* is invalid"),
        ({"nodes": lambda old: [{**old[0], "scale": [1e308] * 3}]}, "vertices are not finite"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_glb_that_asks_for_more_than_a_scan_has_is_refused(tmp_path, changes, why):
    with pytest.raises(SceneError, match=why):
        read_painted(glb_changed(tmp_path / "scan.glb", **changes))


def test_one_picture_that_many_materials_of_a_glb_share_is_kept_once(tmp_path):
    path = glb_changed(tmp_path / "scan.glb", materials=many(400), meshes=primitives(400))
    textures = [one.texture for one in read_painted(path).materials]
    assert len(textures) == 400
    assert all(one is textures[0] for one in textures)
