"""The renderer for training against torch in double precision, and against the shipped renderer."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import twin_reference as reference
from splat_rooms import cloud, eye_camera, psnr, room

from nw_base.errors import UsageError
from nw_splat.camera import Camera, look_at
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store
from nw_twin.gaussians.images import Images
from nw_twin.gaussians.rasteriser import Rasteriser, Threads


def _camera(width=97, height=61, *, scale=1.0):
    """A camera before the cloud; the image is of no round size and has two windows."""
    T = look_at((-5.0, -6.0, 3.0), (0.5, -1.0, 2.0))
    T[:3, :3] *= scale
    return Camera(width=width, height=height, fx=80.0, fy=84.0, cx=45.0, cy=33.0, T_world_camera=T)


def _upstream(images, seed=0):
    rng = np.random.default_rng(seed)
    names = ("rgb", "alpha", "inverse_depth")
    drawn = {name: rng.normal(size=getattr(images, name).shape) for name in names}
    return Images(**{name: array.astype(np.float32) for name, array in drawn.items()})


def _compared(gaussians, camera, **options):
    """Return pictures and gradients of a rasteriser, and those of torch in double precision."""
    rasteriser = Rasteriser(**options)
    images = rasteriser.render(gaussians, camera)
    upstream = _upstream(images)
    p, ray = reference.parameters(gaussians), options.pop("projection", "ray") == "ray"
    pictures = reference.render(p, camera, tile=64, ray=ray, **options)
    total = sum(
        (torch.tensor(g, dtype=torch.float64) * picture).sum()
        for g, picture in zip(upstream.arrays(), pictures, strict=True)
    )
    total.backward()
    return images, rasteriser.backward(upstream), [one.detach().numpy() for one in pictures], p


def _relative(value, truth):
    return np.linalg.norm(value - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("projection", "degree", "antialiased", "scale"),
    [
        ("ray", 0, True, 1.0),
        pytest.param("ewa", 1, False, 1.0, marks=pytest.mark.nightly),
        pytest.param("ray", 2, True, 2.5, marks=pytest.mark.nightly),
        ("ray", 3, False, 1.0),
        pytest.param("ewa", 3, True, 1.0, marks=pytest.mark.nightly),
    ],
)
def test_gradients_are_those_of_torch_in_double_precision(projection, degree, antialiased, scale):
    images, gradients, pictures, p = _compared(
        cloud(400, degree=degree),
        _camera(scale=scale),
        antialiased=antialiased,
        projection=projection,
        background=(0.3, 0.9, 0.1),
    )
    for mine, truth in zip(images.arrays(), pictures, strict=True):
        assert np.abs(mine - truth).max() < 1e-4
    assert gradients.visible.sum() > 200
    for name in reference.NAMES:
        truth = p[name].grad.numpy()
        assert _relative(getattr(gradients, name), truth) < 1e-4, name


@pytest.mark.parametrize("projection", ["ewa", pytest.param("ray", marks=pytest.mark.nightly)])
def test_gradients_hold_for_opaque_walls_and_splats_as_wide_as_the_image(projection):
    images, gradients, _, p = _compared(
        room(1500, degree=1), eye_camera(2, 64, 36), projection=projection
    )
    assert (images.alpha > 0.999).any()  # Pixels that finish early are among them.
    for name in reference.NAMES:
        assert _relative(getattr(gradients, name), p[name].grad.numpy()) < 1e-4, name


def test_gradients_along_the_ray_hold_before_a_low_wide_camera():
    ground = cloud(300, degree=1, spread=(1.5, 1.5, 0.02), centre=(0.8, 0.0, -0.05))
    ground = replace(ground, log_scales=ground.log_scales + np.float32([2.5, 2.5, -1.0]))
    focal = 48.0 / np.tan(np.radians(60.5))
    camera = Camera(
        width=96, height=54, fx=focal, fy=focal, cx=48.0, cy=27.0,
        T_world_camera=look_at((0.0, 0.0, 0.25), (1.0, 0.2, 0.0)),
    )  # fmt: skip
    images, gradients, pictures, p = _compared(ground, camera)
    assert np.abs(images.rgb - pictures[0]).max() < 4.5e-3  # A splat more or less at 1/255.
    for name in reference.NAMES:
        assert _relative(getattr(gradients, name), p[name].grad.numpy()) < 1e-3, name
    tangent = Rasteriser(projection="ewa").render(ground, camera)
    assert psnr((tangent.rgb, pictures[0])) < 30.0, "which EWA does not"


# A footprint ends where alpha is 1/255, and its edge moves with its shape: that gives each step a
# little more effect than the gradient says, of any renderer of this kind.
@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("means", 0.04),
        ("log_scales", 0.04),
        ("quats", 0.04),
        ("opacity_logits", 0.006),
        ("sh", 1e-3),
    ],
)
def test_gradients_predict_what_a_small_step_changes(name, tolerance):
    gaussians = cloud(60, degree=1)
    gaussians = replace(
        gaussians,
        log_scales=gaussians.log_scales + 1.2,
        opacity_logits=gaussians.opacity_logits + 2.0,
    )
    camera, rasteriser = _camera(), Rasteriser()
    y, x = np.mgrid[:61, :97] / 30.0
    smooth = (np.sin(x + y) + 1.5).astype(np.float32)
    upstream = Images(
        rgb=np.stack([smooth, 0.5 * smooth, smooth[::-1]]),
        alpha=smooth[:, ::-1].copy(),
        inverse_depth=smooth,
    )

    def score(values):
        images = rasteriser.render(replace(gaussians, **{name: values}), camera)
        pairs = zip(upstream.arrays(), images.arrays(), strict=True)
        return sum(float((weight.astype(np.float64) * image).sum()) for weight, image in pairs)

    start = getattr(gaussians, name)
    score(start)
    gradient = getattr(rasteriser.backward(upstream), name)
    length = float(np.linalg.norm(gradient))
    step = 1e-2 * gradient / length
    slope = (score(start + step) - score(start - step)) / 2e-2
    assert slope == pytest.approx(length, rel=tolerance)


@pytest.mark.parametrize(
    ("projection", "antialiased"), [("ray", True), ("ray", False), ("ewa", True)]
)
def test_the_picture_is_the_shipped_renderers(projection, antialiased):
    gaussians, pairs = room(20_000, degree=0), []
    options = {"projection": projection, "antialiased": antialiased}
    shipped = CpuRenderer(memory_store(gaussians), **options)
    rasteriser = Rasteriser(**options)
    for pose in range(3):
        camera = eye_camera(pose, 160, 90)
        mine, theirs = rasteriser.render(gaussians, camera), shipped.render(camera)
        pairs += [(mine.rgb.transpose(1, 2, 0), theirs.rgb)]
        # One splat more or less at the threshold of 1/255, of a colour up to 1.5 apart.
        assert np.abs(pairs[-1][0] - pairs[-1][1]).max() < 1.5 / 255
        assert np.abs(mine.alpha - theirs.alpha).max() < 1 / 255
    assert psnr(*pairs) > 90.0


def test_harmonics_differ_from_the_shipped_renderers_by_its_half_precision_only():
    gaussians, camera = room(20_000, degree=3), eye_camera(0, 160, 90)
    mine = Rasteriser().render(gaussians, camera).rgb.transpose(1, 2, 0)
    shipped = CpuRenderer(memory_store(gaussians), projection="ray")
    assert psnr((mine, shipped.render(camera).rgb)) > 80.0


def test_no_bit_depends_on_the_number_of_threads():
    gaussians, camera = room(12_000, degree=1), eye_camera(1, 200, 90)
    found = []
    for threads in (1, 2, 3):
        rasteriser = Rasteriser(workers=Threads(threads))
        images = rasteriser.render(gaussians, camera)
        found.append((images, rasteriser.backward(_upstream(images))))
    for images, gradients in found[1:]:
        for mine, first in zip(images.arrays(), found[0][0].arrays(), strict=True):
            assert (mine == first).all()
        for name in (*reference.NAMES, "centres", "visible"):
            assert (getattr(gradients, name) == getattr(found[0][1], name)).all(), name


@pytest.mark.parametrize(("width", "height"), [(81, 5), (160, 1), (3, 7)])
def test_windows_of_one_column_and_images_of_one_row_have_their_gradients(width, height):
    camera = replace(_camera(), width=width, height=height, cx=width / 2, cy=height / 2)
    images, gradients, pictures, p = _compared(cloud(150, degree=0), camera)
    for mine, truth in zip(images.arrays(), pictures, strict=True):
        assert np.abs(mine - truth).max() < 1e-4
    assert _relative(gradients.means, p["means"].grad.numpy()) < 1e-4


def test_a_view_of_nothing_is_the_background():
    gaussians, camera = cloud(30), _camera()
    far = replace(gaussians, means=gaussians.means + np.float32([0, 0, 1e6]))
    rasteriser = Rasteriser(background=(0.2, 0.4, 0.6))
    images = rasteriser.render(far, camera)
    assert (images.rgb == np.float32([0.2, 0.4, 0.6])[:, None, None]).all()
    assert not rasteriser.backward(_upstream(images)).visible.any()


def test_a_degree_that_is_not_in_use_yet_gets_no_gradient():
    gaussians, camera, rasteriser = cloud(200, degree=3), _camera(), Rasteriser()
    images = rasteriser.render(gaussians, camera, sh_degree=1)
    sh = rasteriser.backward(_upstream(images)).sh
    assert (sh[:, 4:] == 0).all()
    assert (sh[:, :4] != 0).any()


def test_who_is_behind_the_camera_is_not_visible_and_gets_no_gradient():
    gaussians, camera = cloud(300), _camera()
    behind = gaussians.means.copy()
    behind[:150] = camera.T_world_camera[:3, 3] - 3 * camera.T_world_camera[:3, 2]
    rasteriser = Rasteriser()
    images = rasteriser.render(replace(gaussians, means=behind), camera)
    gradients = rasteriser.backward(_upstream(images))
    assert not gradients.visible[:150].any()
    assert (gradients.means[:150] == 0).all()
    assert (gradients.centres[:150] == 0).all()


def test_a_gradient_of_nothing_or_of_another_size_is_refused():
    rasteriser = Rasteriser()
    with pytest.raises(UsageError, match="render first"):
        rasteriser.backward(Images.zeros(8, 8))
    rasteriser.render(cloud(10), _camera())
    with pytest.raises(UsageError, match="shape"):
        rasteriser.backward(Images.zeros(8, 8))
