"""Descriptions, framing cameras, PNG and GIF, warm-up."""

import math
import re
import subprocess
import sys
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture
from splat_rooms import cloud

from nw_base.errors import SceneError, UsageError
from nw_sim.warmup import warmup
from nw_splat.camera import Camera, look_at
from nw_splat.cli import splat_page
from nw_splat.gaussians import concatenate, describe
from nw_splat.portrait import framing_camera, orbit, save_gif, save_png
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store


def test_a_description_counts_what_is_there():
    gaussians = cloud(1000, degree=2)
    gaussians.opacity_logits[:] = 0.0  # Opacity one half.
    gaussians.opacity_logits[:100] = -9.0
    gaussians.sh[5, 0, 0] = np.nan
    gaussians.means[:, 0] = np.linspace(-3, 7, 1000)
    told = describe(gaussians)
    assert (told.count, told.not_finite, told.sh_degree) == (1000, 1, 2)
    assert told.visible == 900
    assert told.opacity_histogram == (99, 0, 0, 0, 0, 900, 0, 0, 0, 0)
    assert (told.bounds[0][0], told.bounds[1][0]) == (-3, 7)
    assert told.bulk[0][0] == pytest.approx(-2.9, abs=0.01)
    text = splat_page(told)
    assert "1,000 (900 visible, 1 cannot be drawn)" in text
    assert "0.5-0.6        900 ####" in text


def test_describing_nothing_finite_does_not_fail():
    gaussians = cloud(3)
    gaussians.means[:] = np.nan
    assert describe(gaussians).visible == 0
    with pytest.raises(SceneError, match="no Gaussian has a finite centre"):
        framing_camera(gaussians, width=8, height=8)


@pytest.mark.parametrize("up", ["+z", "-y", "+x"])
def test_a_framing_camera_has_the_bulk_in_view_and_up_upwards(up):
    gaussians = cloud(2000)
    camera = framing_camera(gaussians, width=90, height=120, up=up)
    p = gaussians.means @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
    u, v = camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy
    inside = (p[:, 2] > 0) & (u > 0) & (u < 90) & (v > 0) & (v < 120)
    assert inside.mean() > 0.95
    upward = np.eye(3)["xyz".index(up[1])] * (1 if up[0] == "+" else -1)
    assert (camera.T_camera_world[:3, :3] @ upward)[1] < -0.9


def test_a_sky_far_around_a_scene_is_not_framed():
    gaussians = cloud(2000)
    bare = framing_camera(gaussians, width=90, height=120)
    sky = gaussians.take(np.arange(200))
    sky.means[:] = np.random.default_rng(0).normal(size=(200, 3))
    sky.means[:] *= 300.0 / np.linalg.norm(sky.means, axis=1, keepdims=True)
    around = framing_camera(concatenate(gaussians, sky), width=90, height=120)
    far = np.linalg.norm(around.T_world_camera[:3, 3] - bare.T_world_camera[:3, 3])
    assert far < 0.1 * np.linalg.norm(bare.T_world_camera[:3, 3])


def test_an_orbit_turns_and_becomes_a_gif(tmp_path):
    gaussians = cloud(500)
    frames = list(
        orbit(CpuRenderer(memory_store(gaussians)), gaussians, frames=5, width=40, height=30)
    )
    assert np.abs(frames[0].rgb - frames[2].rgb).max() > 0.05
    save_gif(tmp_path / "a.gif", frames, rate=10)
    with Picture.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["duration"]) == (5, (40, 30), 100)
    with pytest.raises(SceneError, match="no frames"):
        save_gif(tmp_path / "b.gif", [])
    assert not (tmp_path / "b.gif").exists()


def test_a_png_holds_the_bytes_of_the_image(tmp_path):
    gaussians = cloud(500)
    image = CpuRenderer(memory_store(gaussians)).render(
        framing_camera(gaussians, width=40, height=30)
    )
    save_png(tmp_path / "a.png", image)
    with Picture.open(tmp_path / "a.png") as picture:
        assert np.array_equal(np.asarray(picture), image.bytes())


def test_bytes_are_truncated_as_the_published_pipeline_does():
    gaussians = cloud(5)
    image = CpuRenderer(memory_store(gaussians)).render(
        framing_camera(gaussians, width=2, height=2)
    )
    image.rgb[:] = np.float32([-0.5, 0.99999, 3.0])
    assert (image.bytes() == [0, 254, 255]).all()


def test_warming_up_twice_is_quick_the_second_time():
    warmup()
    assert warmup() < 0.5


def test_after_warming_up_no_camera_compiles_anything():
    program = """\
from dataclasses import replace
import numpy as np
from nw_base.lens import Distortion
from nw_splat.camera import Camera, Pixels
from nw_splat.render import CpuRenderer
from nw_splat.kernels.draw import draw
from nw_sim.warmup import warmup
from splat_rooms import room
from nw_splat.store import memory_store

warmup()
kinds = len(draw.signatures)
straight = Camera.from_fovy(width=40, height=24, fovy=1.0, T_world_camera=np.eye(4))
brown = Distortion(model="radial_tangential", coefficients=(-0.1, 0.01, 0.0, 0.0, 0.0))
fisheye = Distortion(model="fisheye", coefficients=(0.01, 0.0, 0.0, 0.0))
store = memory_store(room(300, degree=1))
for lens in (None, brown, fisheye):
    for samples in (1, 4):
        for projection in ("ewa", "ray"):
            renderer = CpuRenderer(store, projection=projection, samples=samples, threads=2)
            renderer.render(replace(straight, distortion=lens), Pixels(stride=2))
print(kinds, len(draw.signatures))
"""
    out = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
    )
    before, after = out.stdout.split()
    assert before == after


def test_the_first_install_compiles_with_the_packages_that_it_has_by_then():
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    (early,) = re.findall(r"\$\(PIP\) -c constraints.txt (numba .*)", makefile)
    needed = [each for each in requires("nw-eval") if "extra ==" not in each]
    late = {re.match(r"[\w.-]+", each)[0] for each in needed} - set(early.split())
    modules = [name for name, of in packages_distributions().items() if late & set(of)]
    assert {"mujoco", "pandas"} <= set(modules)
    program = f"import sys; sys.modules.update(dict.fromkeys({modules}))\n"
    program += "import nw_sim.warmup, nw_splat.render"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_camera_from_a_view_angle_has_the_published_focal_length():
    # Published: fovy 90 degrees at 1280x720 is f = 360 px, cx 640, cy 360.
    camera = Camera.from_fovy(width=1280, height=720, fovy=math.pi / 2, T_world_camera=np.eye(4))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((360, 360, 640, 360))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "camera width is 0; give 1 to 16384"),
        ({"fx": float("nan")}, "camera fx is nan"),
        ({"near": 0.0}, "near=0.0"),
        ({"T_world_camera": np.eye(3)}, "finite 4x4"),
        ({"T_world_camera": np.diag([1.0, 2, 1, 1])}, "not a rotation times a scale"),
    ],
)
def test_a_camera_that_makes_no_sense_names_the_field(change, message):
    good = {"width": 8, "height": 8, "fx": 5.0, "fy": 5.0, "cx": 4.0, "cy": 4.0}
    with pytest.raises(UsageError, match=message):
        Camera(**(good | {"T_world_camera": np.eye(4)} | change))


def test_looking_along_up_is_refused():
    with pytest.raises(UsageError, match="choose another target or up"):
        look_at((0, 0, 0), (0, 0, 5))
