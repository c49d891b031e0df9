from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from nw_places.bake.generate import generate
from nw_places.entry import LIGHTS, BuiltInSplat
from nw_places.places import scenery as outdoors
from nw_places.places.builder import SceneBuilder
from nw_scenes.rays import RayScene
from nw_sim.catalogue import get_scene
from nw_splat.camera import Camera
from nw_splat.gaussians import SH0
from nw_splat.render import CpuRenderer
from nw_splat.store import digest, open_store


def tiny_place():
    """A bar on a lawn beside a bush, in the evening light of a lamp."""
    builder = SceneBuilder("tiny", LIGHTS["dusk"], indoor=False, eyes=[(0, 0, 0.3), (2, 0, 0.3)])
    builder.ground("grass/green", (-2, 4), (-2, 2))
    builder.lawn((-1, 2), (-1, 1), "grass/green")
    builder.box((1, 1.3), (-0.5, 0.5), (0, 0.2), "brick/red", kind="obstacle")
    outdoors.bush(builder, 2.5, 1.2, 0.4)
    outdoors.lamp_post(builder, 2.0, -1.5, lit=True)
    return builder.place()


def test_the_same_place_gives_the_same_bytes():
    first, second = (generate(tiny_place(), budget=3000) for _ in range(2))
    assert digest(first) == digest(second)


@pytest.mark.nightly
def test_the_bytes_do_not_depend_on_threads_or_hash_seeds():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]);"
        "from test_scene_splat import tiny_place; from nw_splat.store import digest;"
        "from nw_places.bake.generate import generate;"
        "print(digest(generate(tiny_place(), budget=3000)))"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code, str(__file__).rsplit("/", 1)[0]],
            capture_output=True,
            text=True,
            check=True,
            env={"OMP_NUM_THREADS": threads, "PYTHONHASHSEED": seed, "NUMBA_NUM_THREADS": threads},
        ).stdout.strip()
        for threads, seed in (("1", "1"), ("2", "99"))
    }
    assert len(found) == 1


def test_a_scene_has_100_000_to_300_000_gaussians_in_its_store(built):
    assert 100_000 <= open_store(built.store).count <= 300_000


def test_a_store_is_made_once(built, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(built.cache))
    before = built.store.stat().st_mtime_ns
    assert built.scene.splat_store() == built.store
    assert built.store.stat().st_mtime_ns == before


@pytest.mark.nightly
def test_a_damaged_store_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path))
    splat = BuiltInSplat(place=tiny_place())
    path = splat.store()
    path.write_bytes(path.read_bytes()[:1000])
    assert splat.store() == path
    assert open_store(path).count > 1000


def test_progress_rises_to_one(built):
    shares = [share for _, share in built.reports]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(set(shares)) > 4


@pytest.fixture(scope="module")
def tiny():
    return generate(tiny_place(), budget=3000)


def test_all_numbers_are_finite_and_scales_sane(tiny):
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.isfinite(getattr(tiny, name)).all(), name
    assert np.abs(np.linalg.norm(tiny.quats, axis=1) - 1).max() < 1e-5
    assert np.exp(tiny.log_scales).max() < 40
    assert np.exp(tiny.log_scales).min() > 1e-4


def test_colours_are_what_a_screen_can_show(tiny):
    rgb = 0.5 + SH0 * tiny.sh[:, 0]
    assert rgb.min() >= -1e-5
    assert rgb.max() <= 1 + 1e-5
    assert rgb.std() > 0.05


def _eye(width=160, height=90, hfov=1.9):
    pose = np.eye(4)
    # Camera axes (right, down, forward) in a world where x is ahead and z up.
    pose[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    pose[:3, 3] = (0, 0, 0.3)
    focal = width / 2 / math.tan(hfov / 2)
    return Camera.from_fovy(
        width=width, height=height, fovy=2 * math.atan(height / 2 / focal), T_world_camera=pose
    )


def test_the_splat_is_where_the_geometry_is(built):
    """What a camera measures in the splat agrees with rays against the mesh."""
    camera = _eye()
    image = CpuRenderer(open_store(built.store)).render(camera)
    assert image.alpha.min() > 0.97
    columns, rows = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
    ways = np.stack(
        [
            np.ones(columns.size),
            -(columns.ravel() - camera.cx) / camera.fx,
            -(rows.ravel() - camera.cy) / camera.fy,
        ],
        axis=1,
    )
    norm = np.linalg.norm(ways, axis=1)
    rays = RayScene(get_scene(built.scene.name).mesh())
    distance, _ = rays.cast(np.tile([0, 0, 0.3], (len(ways), 1)), ways / norm[:, None])
    depth = (distance / norm).reshape(90, 160)
    # Edges blur over a pixel or two, so the middle of the errors counts, not the worst.
    error = np.abs(image.depth - depth) / depth
    assert np.median(error) < 0.015
    assert np.percentile(error[60:], 90) < 0.04


def test_the_bar_stands_out_from_the_carpet(built):
    image = CpuRenderer(open_store(built.store)).render(_eye())
    carpet = image.rgb[80, 60:100].mean(axis=0)
    # The bar's front spans 1.5 m ahead, 0 to 0.15 m high: rows 50 to 53 of the image.
    bar = image.rgb[50:53, 70:90].mean(axis=(0, 1))
    assert carpet[2] > carpet[0]  # Blue carpet.
    assert bar[0] > bar[2]  # Wood.
