"""A surface is drawn through the points of a scanner or a phone, and robots can stand on it."""

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes.folder import load_folder
from nw_scenes.rays import RayScene
from nw_twin.scans.points import is_cloud, is_splat, read_cloud, surfaced
from nw_twin.scans.scan import ScanOptions, import_scan

laspy = pytest.importorskip("laspy")
pytest.importorskip("libusb_package")


def on_box(rng, low, high, density, *, inside=False):
    """Return points on the faces of a box, as many for each square metre, without its bottom."""
    low, high = np.array(low, float), np.array(high, float)
    size = high - low
    found = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        for end in (low, high):
            if axis == 2 and end is low and not inside:
                continue
            count = int(density * size[others[0]] * size[others[1]])
            points = low + rng.random((count, 3)) * size
            points[:, axis] = end[axis]
            found.append(points)
    return np.concatenate(found)


def yard(seed=0, density=4000):
    """Return points of level ground of 5 x 3 m with a block of 0.2 m on it, 3 mm of noise."""
    rng = np.random.default_rng(seed)
    ground = rng.random((int(15 * density), 3)) * [5.0, 3.0, 0.0] - [1.0, 1.5, 0.0]
    under = (np.abs(ground[:, 0] - 2.5) < 0.4) & (np.abs(ground[:, 1]) < 0.5)
    block = on_box(rng, (2.1, -0.5, 0.0), (2.9, 0.5, 0.2), density)
    points = np.concatenate([ground[~under], block])
    return points + rng.normal(0.0, 0.003, points.shape)


def ply(path, points, colours=None):
    """Write an ASCII PLY of points, as phones' apps do."""
    if colours is not None:
        colours = np.broadcast_to(colours, (len(points), 3))
    rows = points if colours is None else np.column_stack([points, colours])
    said = [f"property float {axis}" for axis in "xyz"]
    said += [] if colours is None else [f"property uchar {c}" for c in ("red", "green", "blue")]
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *said]
    # Apps write the element without rows, too.
    head += ["element face 0", "property list uchar int vertex_indices", "end_header"]
    form = "%.4f %.4f %.4f" + ("" if colours is None else " %d %d %d")
    with path.open("w") as file:
        file.write("\n".join(head) + "\n")
        np.savetxt(file, rows, fmt=form)
    return path


@pytest.mark.parametrize("suffix", [".ply", pytest.param(".las", marks=pytest.mark.nightly)])
def test_ground_and_a_block_are_where_their_points_are(tmp_path, suffix):
    points = yard()
    source = tmp_path / f"yard{suffix}"
    if suffix == ".ply":
        ply(source, points)
    else:
        file = laspy.create(point_format=2, file_version="1.2")
        file.header.scales = [0.0005] * 3
        file.header.offsets = [0.0, 0.0, 0.0]
        file.x, file.y, file.z = points.T
        file.write(source)
    assert is_cloud(source)
    mesh, lines = surfaced(source, "auto")
    assert "a surface was drawn through 62,9" in lines[0]
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normal[:, 2].sum() > 0.0, "the ground looks up"
    written = import_scan(source, tmp_path / "scene", ScanOptions(licence="CC0-1.0"))
    scene = load_folder(tmp_path / "scene")
    ground = -scene.spawn.position[2] + RayScene(scene.mesh()).height(
        np.array([[0.0, -1.0], [0.5, 1.0], [3.4, 0.5]])
    )
    np.testing.assert_allclose(ground, 0.0, atol=0.01)
    top = RayScene(scene.mesh()).height(np.array([[2.5, 0.0], [2.3, -0.3], [2.7, 0.3]]))
    np.testing.assert_allclose(top, 0.2, atol=0.015)
    assert written.fault is None


def test_a_room_of_points_is_open_inside_and_stands_on_its_floor(tmp_path):
    rng = np.random.default_rng(1)
    shell = on_box(rng, (0, 0, 0), (4, 3, 2.5), 1500, inside=True)
    table = on_box(rng, (1.0, 1.0, 0.0), (2.0, 1.6, 0.7), 1500)
    points = np.concatenate([shell, table]) + rng.normal(0.0, 0.003, (len(shell) + len(table), 3))
    written = import_scan(
        ply(tmp_path / "room.ply", points), tmp_path / "room", ScanOptions(licence="CC0-1.0")
    )
    assert any("up is +z" in line for line in written.lines)
    rays = RayScene(load_folder(tmp_path / "room").mesh())
    assert float(rays.height(np.array([[3.0, 2.0]]), z_from=1.0)[0]) == pytest.approx(0.0, abs=0.02)
    assert float(rays.height(np.array([[1.5, 1.3]]), z_from=1.5)[0]) == pytest.approx(0.7, abs=0.02)


def test_the_same_points_give_the_same_surface_and_colours_come_along(tmp_path):
    points = yard(2, density=800)
    colours = np.where(points[:, :1] > 1.0, [[200, 30, 30]], [[30, 30, 200]])
    source = ply(tmp_path / "yard.ply", points, colours)
    one, two = surfaced(source, "auto")[0], surfaced(source, "auto")[0]
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.faces, two.faces)
    corners = one.vertices[one.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normal, axis=1).min() > 0.0, "all faces have an area"
    middles = one.vertices[one.faces].mean(axis=1)
    red = one.colours.mean(axis=1)[:, 0]
    assert red[middles[:, 0] > 1.3].mean() > 0.7
    assert red[middles[:, 0] < 0.7].mean() < 0.2


def test_points_far_from_the_origin_keep_their_detail(tmp_path):
    # Survey coordinates, in which single precision has steps of half a metre.
    points = yard(3, density=800) + np.array([4_500_000.0, 5_300_000.0, 400.0])
    file = laspy.create(point_format=2, file_version="1.2")
    file.header.scales, file.header.offsets = [0.001] * 3, points.min(axis=0)
    file.x, file.y, file.z = points.T
    file.write(tmp_path / "far.las")
    mesh, _ = surfaced(tmp_path / "far.las", "+z")
    height = mesh.vertices[:, 2] - 400.0
    assert -0.05 < height.min() < height.max() < 0.25
    assert np.quantile(height, 0.5) == pytest.approx(0.0, abs=0.01)


def area(mesh):
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(normal, axis=1).sum()) / 2.0


def test_points_that_stand_twice_or_far_off_change_nothing(tmp_path):
    points = yard(4, density=800)
    plain, _ = surfaced(ply(tmp_path / "plain.ply", points), "+z")
    twice, _ = surfaced(ply(tmp_path / "twice.ply", np.concatenate([points, points])), "+z")
    assert area(twice) == pytest.approx(area(plain), rel=0.02)
    stray = np.concatenate([points, [[500.0, 0.0, 0.0]]])
    off, lines = surfaced(ply(tmp_path / "stray.ply", stray), "+z")
    assert area(off) == pytest.approx(area(plain), rel=0.02)
    assert "1 point far from all others" in lines[1]


def test_a_floor_without_noise_is_a_floor(tmp_path):
    flat = np.random.default_rng(5).random((20_000, 3)) * [4.0, 3.0, 0.0]
    mesh, _ = surfaced(ply(tmp_path / "flat.ply", flat), "+z")
    assert area(mesh) == pytest.approx(12.0, rel=0.1)
    np.testing.assert_allclose(mesh.vertices[:, 2], 0.0, atol=2e-3)


@pytest.mark.parametrize(
    ("kind", "white"),
    [("uchar", 255), ("ushort", 65535), ("int", 255), ("float", 255), ("float", 1)],
)
def test_white_points_are_white_whatever_the_type_of_their_colours(tmp_path, kind, white):
    path = ply(tmp_path / "white.ply", yard(6, density=200), np.full((1, 3), white))
    path.write_text(path.read_text().replace("property uchar", f"property {kind}"))
    assert read_cloud(path).colours.min() == 1.0


def test_what_is_no_usable_cloud_is_said(tmp_path):
    few = ply(tmp_path / "few.ply", yard(0)[:900])
    with pytest.raises(SceneError, match="900 different points: too few for a surface"):
        surfaced(few, "auto")
    same = ply(tmp_path / "same.ply", np.zeros((2000, 3)))
    with pytest.raises(SceneError, match="1 different point: too few"):
        surfaced(same, "auto")
    line = ply(tmp_path / "line.ply", np.outer(np.linspace(0.0, 5.0, 3000), [1.0, 0.5, 0.0]))
    with pytest.raises(SceneError, match="lie on a line"):
        surfaced(line, "auto")
    huge = tmp_path / "huge.ply"
    ply(huge, yard(0)[:2000])
    huge.write_text(huge.read_text().replace("end_header\n", "end_header\n1e30 0 0\n", 1))
    with pytest.raises(SceneError, match=r"coordinates of up to 1e\+30"):
        surfaced(huge, "auto")
    with pytest.raises(SceneError, match=r"gone\.las: the points cannot be read: No such file"):
        read_cloud(tmp_path / "gone.las")
    broken = tmp_path / "broken.las"
    broken.write_bytes(b"LASF" + bytes(300))
    with pytest.raises(SceneError, match=r"broken\.las: no point cloud can be read in it"):
        read_cloud(broken)
    splat = tmp_path / "splat.ply"
    splat.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nproperty float f_dc_0\nend_header\n0 0 0 1\n"
    )
    assert is_splat(splat)
