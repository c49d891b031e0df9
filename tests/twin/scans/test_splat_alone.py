"""A splat alone becomes a mesh that lies where its Gaussians do, and shows the splat itself."""

import numpy as np
import pytest
import trimesh

from nw_base.errors import SceneError
from nw_scenes.folder import load_folder
from nw_scenes.mesh_file import read_painted
from nw_scenes.rays import RayScene
from nw_splat.files import read_splat, write_splat
from nw_splat.gaussians import concatenate
from nw_twin.gaussians.initial import gaussians_at
from nw_twin.scans.looks import painted_gaussians
from nw_twin.scans.points import is_cloud, is_splat, read_cloud, surfaced
from nw_twin.scans.scan import ScanOptions, import_scan

pytest.importorskip("libusb_package")


UPRIGHT = np.eye(3)


def yard(folder, rng, *, axes=UPRIGHT):
    """Write a splat of a floor of 5 x 3 m with a block of 0.2 m, with sky round it and haze."""
    parts = [
        trimesh.Trimesh(
            [(-1, -1.5, 0), (4, -1.5, 0), (4, 1.5, 0), (-1, 1.5, 0)], [(0, 1, 2), (0, 2, 3)]
        ),
        trimesh.creation.box((0.8, 1.0, 0.2)).apply_translation((2.5, 0.6, 0.1)),
    ]
    parts[1].update_faces(parts[1].face_normals[:, 2] > -0.5)  # No splat has an underside.
    mesh = trimesh.util.concatenate(parts)
    mesh.visual.vertex_colors = np.tile([120, 90, 60, 255], (len(mesh.vertices), 1))
    mesh.apply_transform(np.block([[axes, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    mesh.export(folder / "yard.ply")
    solid, *_ = painted_gaussians(read_painted(folder / "yard.ply"), most=9_000)
    x, y, z = (solid.means @ axes).T
    seen = (np.abs(x - 2.5) > 0.4) | (np.abs(y - 0.6) > 0.5) | (z > 0.05)  # Not below the block.
    solid = solid.take(rng.permutation(np.flatnonzero(seen)))
    away = rng.normal(size=(300, 3))
    away *= 60.0 / np.linalg.norm(away, axis=1, keepdims=True)
    sky = gaussians_at(away, np.ones((300, 3)), None, sh_degree=0, opacity=0.9, size=0.5)
    inside = rng.uniform((-1, -1.5, 0.0), (4, 1.5, 1.5), (500, 3)) @ axes.T
    haze = gaussians_at(inside, np.ones((500, 3)), None, sh_degree=0, opacity=0.05)
    write_splat(folder / "splat.ply", concatenate(solid, sky, haze))
    return folder / "splat.ply"


def test_the_mesh_of_a_splat_lies_where_its_surfaces_are(tmp_path):
    source = yard(tmp_path, np.random.default_rng(0))
    assert is_cloud(source)
    assert is_splat(source)
    cloud = read_cloud(source)
    assert "500 Gaussians of an opacity below 0.2" in cloud.unread
    assert "300 Gaussians over 8 times as large as usual" in cloud.unread
    np.testing.assert_allclose(cloud.colours.mean(axis=0) * 255, (120, 90, 60), atol=2.0)
    written = import_scan(source, tmp_path / "scene", ScanOptions(up="+z", trail=((0, 0), (2, 0))))
    scene = load_folder(tmp_path / "scene")
    rays = RayScene(scene.mesh())
    for xy, height in (((1.0, -1.0), 0.0), ((2.5, 0.6), 0.2), ((3.7, 1.0), 0.0)):
        at = rays.height(np.array([xy]), z_from=np.array([1.0]))[0]
        ground = rays.height(np.array([[0.0, 0.0]]), z_from=np.array([1.0]))[0]
        assert at - ground == pytest.approx(height, abs=0.02)
    assert any("a splat alone: most are trained in a unit of their own" in x for x in written.lines)
    assert (tmp_path / "scene" / "splat.ply").read_bytes() == source.read_bytes()
    assert len(read_splat(tmp_path / "scene" / "splat.ply")) > 1000


def test_a_splat_in_the_axes_of_a_camera_is_not_turned_inside_out(tmp_path):
    c, s = np.cos(1.9), np.sin(1.9)  # Up is somewhere between -y and -z, as of a first camera.
    axes = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    mesh, _ = surfaced(yard(tmp_path, np.random.default_rng(1), axes=axes), "auto")
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal @ axes[:, 2]).sum() > 0.3 * np.linalg.norm(normal, axis=1).sum()


def test_a_splat_without_an_opaque_gaussian_is_an_error(tmp_path):
    points = np.random.default_rng(2).random((50, 3))
    haze = gaussians_at(points, np.ones((50, 3)), None, sh_degree=0, opacity=0.1)
    write_splat(tmp_path / "haze.ply", haze)
    with pytest.raises(SceneError, match=r"haze\.ply: no Gaussian is opaque"):
        read_cloud(tmp_path / "haze.ply")


def test_a_wide_scan_whose_gaussians_are_coarse_is_not_called_shifted(tmp_path):
    """Of 220 m of ground 200,000 Gaussians are 0.2 m wide; grazed, their centres lie in front."""
    corners = [(-110, -110, 0), (110, -110, 0), (110, 110, 0), (-110, 110, 0)]
    floor = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)])
    floor.visual.vertex_colors = np.tile([90, 120, 60, 255], (4, 1))
    floor.export(tmp_path / "field.ply")
    options = ScanOptions(up="+z", trail=((0, 0), (3, 0)))
    written = import_scan(tmp_path / "field.ply", tmp_path / "scene", options)
    assert not [line for line in written.lines if "splat_shifted" in line or "splat_off" in line]
    (depth,) = [line for line in written.lines if "splat and mesh are" in line]
    assert float(depth.split("splat and mesh are ")[1].split(" m")[0]) < 0.02
