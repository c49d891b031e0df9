"""The CUDA backend: its calls into gsplat, recorded by a fake; and real ones where possible."""

import sys
import types

import numpy as np
import pytest
import torch
from splat_reference import basis
from splat_rooms import cloud, eye_camera, psnr, room

from nw_base.errors import PrerequisiteError, UsageError
from nw_splat.camera import Pixels
from nw_splat.render import CpuRenderer, open_renderer
from nw_splat.store import memory_store, unpack


@pytest.fixture
def gsplat(monkeypatch):
    """A gsplat that records its arguments and returns a ramp."""
    fake = types.ModuleType("gsplat")
    fake.__version__ = "1.5.3"
    fake.calls = []

    def rasterization(**arguments):
        fake.calls.append(arguments)
        height, width = arguments["height"], arguments["width"]
        ramp = torch.arange(height * width, dtype=torch.float32).reshape(1, height, width, 1)
        colours = torch.cat([ramp, ramp + 0.25, ramp + 0.5, ramp + 7], dim=-1)
        # Each camera's picture is brighter by how far its centre is along x.
        along = arguments["viewmats"][:, 0, 3].reshape(-1, 1, 1, 1)
        return colours + along, torch.full((len(along), height, width, 1), 0.75), {}

    fake.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", fake)
    return fake


def test_gsplat_gets_the_shapes_and_conventions_it_documents(gsplat):
    store, camera = memory_store(cloud(100, degree=2)), eye_camera(1, 64, 36)
    renderer = open_renderer(store, "cuda", device="cpu", background=(0.0, 0.5, 1.0))
    renderer.render(camera)
    (call,) = gsplat.calls
    n = store.count
    shapes = {k: tuple(v.shape) for k, v in call.items() if isinstance(v, torch.Tensor)}
    assert shapes == {
        "means": (n, 3),
        "covars": (n, 3, 3),
        "opacities": (n,),
        "colors": (n, 9, 3),
        "viewmats": (1, 4, 4),
        "Ks": (1, 3, 3),
    }
    assert all(v.dtype == torch.float32 for v in call.values() if isinstance(v, torch.Tensor))
    assert (call["sh_degree"], call["width"], call["height"]) == (2, 64, 36)
    assert (call["render_mode"], call["rasterize_mode"]) == ("RGB+ED", "antialiased")
    assert (call["eps2d"], call["near_plane"], call["packed"]) == (0.3, 0.01, False)
    # World to camera: the camera's own place maps to the origin, and what is ahead has z > 0.
    view = call["viewmats"][0].double().numpy()
    eye = np.append(camera.T_world_camera[:3, 3], 1)
    assert view @ eye == pytest.approx([0, 0, 0, 1], abs=1e-5)
    assert (view @ (eye + np.append(camera.T_world_camera[:3, 2], 0)))[2] == pytest.approx(1)
    assert call["Ks"][0].tolist() == [
        pytest.approx([camera.fx, 0, 32]),
        pytest.approx([0, camera.fy, 18]),
        [0, 0, 1],
    ]


def test_the_store_is_handed_over_as_it_was_stored(gsplat):
    gaussians = cloud(50, degree=3)
    store = memory_store(gaussians)
    open_renderer(store, "cuda", device="cpu").render(eye_camera(1, 8, 8))
    (call,) = gsplat.calls
    # Colours along a direction from what gsplat gets equal those from the file.
    order = np.linalg.norm(gaussians.means[None] - call["means"].numpy()[:, None], axis=2).argmin(1)
    d = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8]]), dim=1)
    y = basis(d, 16)[0]
    mine = torch.einsum("k,nkc->nc", y, call["colors"])
    assert mine.numpy() == pytest.approx(
        np.einsum("k,nkc->nc", y.numpy(), gaussians.sh[order]), abs=2e-3
    )
    variance = torch.linalg.eigvalsh(call["covars"].double()).numpy()
    assert np.sqrt(variance) == pytest.approx(
        np.sort(np.exp(gaussians.log_scales[order]), axis=1), rel=1e-2
    )


@pytest.mark.usefixtures("gsplat")
def test_what_comes_back_is_composed_and_cut():
    store = memory_store(cloud(10))
    renderer = open_renderer(store, "cuda", device="cpu", background=(0.0, 0.5, 1.0))
    pixels = Pixels(stride=4, block=2, offset=1)
    image = renderer.render(eye_camera(0, 16, 8), pixels)
    assert image.rgb.shape == (4, 8, 3)
    index = 1 * 16 + 5  # Row 1, column 5: the third column taken.
    along = eye_camera(0, 16, 8).T_camera_world[0, 3]
    shown = [index, index + 0.25 + 0.125, index + 0.5 + 0.25]
    assert image.rgb[0, 2] == pytest.approx([each + along for each in shown], rel=1e-5)
    assert image.depth[0, 2] == pytest.approx(index + 7 + along, rel=1e-5)
    assert (image.alpha == 0.75).all()


def test_cameras_of_one_size_are_drawn_in_one_call_and_come_back_in_their_order(gsplat):
    renderer = open_renderer(memory_store(cloud(10)), "cuda", device="cpu")
    cameras = [eye_camera(number, 16, 8) for number in (2, 0, 1)]
    images = renderer.render_batch(cameras)
    (call,) = gsplat.calls
    assert tuple(call["viewmats"].shape) == (3, 4, 4)
    assert tuple(call["Ks"].shape) == (3, 3, 3)
    for camera, image in zip(cameras, images, strict=True):
        assert (image.rgb == renderer.render(camera).rgb).all()


@pytest.mark.usefixtures("gsplat")
def test_cameras_of_two_sizes_are_no_batch():
    renderer = open_renderer(memory_store(cloud(10)), "cuda", device="cpu")
    with pytest.raises(UsageError, match="a batch of 2 cameras has 2 sizes and planes"):
        renderer.render_batch([eye_camera(0, 16, 8), eye_camera(0, 8, 8)])


def test_without_gsplat_the_error_has_the_pip_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(
        PrerequisiteError, match=r"needs the package gsplat; pip install 'nw-eval\[cuda\]'"
    ):
        open_renderer(memory_store(cloud(10)), "cuda")


def test_another_version_of_gsplat_is_not_taken_for_the_one_asked_for(gsplat):
    gsplat.__version__ = "1.6.0"
    with pytest.raises(PrerequisiteError, match=r"needs gsplat 1\.5, installed is 1\.6\.0"):
        open_renderer(memory_store(cloud(10)), "cuda", device="cpu")
    open_renderer(memory_store(cloud(10)), "cuda", device="cpu", preset="gsplat-1.6")


@pytest.mark.usefixtures("gsplat")
def test_without_a_device_the_error_says_so(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(PrerequisiteError, match="no CUDA device; use --render cpu"):
        open_renderer(memory_store(cloud(10)), "cuda")


@pytest.mark.cuda
def test_a_picture_has_the_same_bits_in_any_batch():
    pytest.importorskip("gsplat")
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    renderer = open_renderer(memory_store(room(100_000)), "cuda")
    cameras = [eye_camera(number, 80, 45) for number in range(8)]
    alone = [renderer.render(camera) for camera in cameras]
    for order in (range(8), (5, 2, 7), (3, 3, 0, 6, 1)):
        for number, image in zip(
            order, renderer.render_batch([cameras[n] for n in order]), strict=True
        ):
            assert (image.rgb == alone[number].rgb).all()
            assert (image.depth == alone[number].depth).all()
            assert (image.alpha == alone[number].alpha).all()


@pytest.mark.cuda
def test_both_backends_draw_the_same_picture():
    pytest.importorskip("gsplat")
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    store = memory_store(room(100_000))
    for number in range(4):
        camera = eye_camera(number, 320, 180)
        cpu = CpuRenderer(store).render(camera)
        cuda = open_renderer(store, "cuda").render(camera)
        assert psnr((cpu.rgb, cuda.rgb)) > 60
        assert np.abs(cpu.rgb - cuda.rgb).max() <= 1 / 255 + 1e-3
        assert unpack(store.layout).means.dtype == np.float32
