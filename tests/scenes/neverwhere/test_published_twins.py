"""Built-in scenes written out as published ones agree with the originals in every sense."""

import numpy as np
import pytest

from nw_places.bake.generate import generate
from nw_places.entries import ENTRIES
from nw_scenes.mesh import rotation_matrix
from nw_scenes.neverwhere import inspect_published, load_published
from nw_scenes.rays import RayScene
from nw_scenes.scene import HeightField
from nw_sim.catalogue import get_scene
from nw_splat.camera import Camera, look_at
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store, open_store

NAMES = ("hurdles/one_low_carpet", "hurdles/three_stops_car_park")


@pytest.fixture(scope="module", params=enumerate(NAMES), ids=NAMES)
def native(request):
    seed, name = request.param
    (entry,) = [entry for entry in ENTRIES if entry.name == name]
    return seed, get_scene(name), generate(entry.place(), budget=20_000)


@pytest.fixture
def published(native, writer_of):
    seed, scene, gaussians = native
    mesh = scene.mesh()
    arrays = {
        name: getattr(gaussians, name)
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    }
    writer = writer_of(mesh.vertices, mesh.faces, scene.trail, arrays, seed)
    return writer, load_published(f"neverwhere:{writer.write()}")


def views(scene):
    eyes = [scene.trail[0] + [-1.5, 0.1, 0.25], scene.trail[-1] + [-2.0, -0.3, 0.4]]
    return [look_at(eye, eye + np.array([1.0, 0.05, -0.15])) for eye in eyes]


def test_geometry_trail_and_splat_frame_come_back(native, published):
    _, scene, _ = native
    writer, read = published
    assert read.mesh().vertices == pytest.approx(scene.mesh().vertices, abs=1e-9)
    assert (read.mesh().faces == scene.mesh().faces).all()
    assert read.trail == pytest.approx(scene.trail, abs=1e-12)
    expected = writer.label.matrix
    if writer.normalise is not None:
        expected = expected @ np.linalg.inv(writer.normalise.matrix)
    assert read.T_world_splat == pytest.approx(expected, abs=1e-9)


def test_the_checker_finds_nothing_wrong(published):
    writer, _ = published
    findings = inspect_published(writer.folder).findings
    assert [f for f in findings if f.severity == "error"] == []


def test_images_agree(native, published):
    _, scene, gaussians = native
    _, read = published
    original = CpuRenderer(memory_store(gaussians))
    copy = CpuRenderer(open_store(read.splat_store()))
    for T in views(scene):
        kwargs = {"width": 160, "height": 90, "fovy": np.pi / 2}
        there = original.render(Camera.from_fovy(T_world_camera=T, **kwargs))
        T_splat = np.linalg.inv(read.T_world_splat) @ T
        here = copy.render(Camera.from_fovy(T_world_camera=T_splat, **kwargs))
        assert there.alpha.mean() > 0.9
        # Float32 positions in another frame move a splat's edge now and then.
        colour = np.abs(here.rgb - there.rgb).max(axis=2)
        assert np.quantile(colour, 0.99) < 1.5 / 255
        depth = np.abs(here.depth - there.depth) / np.maximum(there.depth, 1.0)
        assert np.quantile(depth, 0.99) < 2e-3


def test_depth_rays_agree(native, published):
    _, scene, _ = native
    _, read = published
    here, there = RayScene(read.mesh()), RayScene(scene.mesh())
    x, y = np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-0.56, 0.56, 45))
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for T in views(scene):
        origins, directions = np.repeat(T[:3, 3][None], len(rays), 0), rays @ T[:3, :3].T
        a, b = here.distance(origins, directions), there.distance(origins, directions)
        same = np.isclose(a, b, rtol=1e-4, atol=1e-4) | (np.isinf(a) & np.isinf(b))
        assert same.mean() > 0.998


def test_heights_under_the_scandots_agree(native, published):
    _, scene, _ = native
    _, read = published
    here, there = RayScene(read.mesh()), RayScene(scene.mesh())
    x, y = np.linspace(-0.45, 1.2, 12), np.linspace(-0.75, 0.75, 11)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    for yaw, center in [(0.1, scene.trail[0]), (-0.3, scene.trail[-1]), (0.0, np.zeros(3))]:
        c, s = np.cos(yaw), np.sin(yaw)
        points = center[:2] + grid @ np.array([[c, s], [-s, c]])
        assert here.height(points) == pytest.approx(there.height(points), abs=1e-5)


def test_what_one_walks_on_is_the_native_solid_ground(native, published):
    _, scene, _ = native
    _, read = published
    random = np.random.default_rng(3)
    way = np.vstack([[0.0, 0.0, 0.0], scene.trail])
    leg = random.integers(len(way) - 1, size=600)
    points = way[leg, :2] + random.uniform(size=(600, 1)) * (way[leg + 1] - way[leg])[:, :2]
    points += random.uniform(-0.25, 0.25, points.shape)
    found = np.max([s.height(points) for s in read.solids if isinstance(s, HeightField)], axis=0)
    found = np.maximum(found, tops([s for s in read.solids if hasattr(s, "half_size")], points))
    truth = np.maximum(tops(scene.solids, points), scene.ground.z)
    error = np.abs(found - truth)
    assert np.median(error) < 1e-4
    assert np.quantile(error, 0.99) < 3e-3


def tops(solids, points):
    """Return how high boxes reach at points, ground level beside them."""
    heights = np.full(len(points), -1.0)
    for box in solids:
        if isinstance(box, HeightField) or box.center[2] - box.half_size[2] > 0.8:
            continue
        R = rotation_matrix(box.quat)
        normal = R[:, 2]
        plane = np.asarray(box.center) + box.half_size[2] * normal
        z = plane[2] - ((points - plane[:2]) @ normal[:2]) / normal[2]
        local = (np.column_stack([points, z]) - box.center) @ R
        inside = (np.abs(local[:, :2]) <= box.half_size[:2]).all(axis=1)
        heights = np.where(inside, np.maximum(heights, z), heights)
    return heights
