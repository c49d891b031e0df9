"""The loss and its gradient against torch's automatic ones."""

import numpy as np
import pytest
import torch
import twin_reference as reference
from skimage.metrics import structural_similarity

from nw_twin.gaussians.loss import depth_loss, photo_loss, psnr
from nw_twin.gaussians.rasteriser import Threads


def _pictures(width, height, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / 9.0
    photo = np.stack([np.sin(x + c) * np.cos(y - c) for c in range(3)]) * 0.4 + 0.5
    photo = (photo + rng.normal(0, 0.05, photo.shape)).clip(0, 1).astype(np.float32)
    picture = (photo * 0.8 + 0.15 + rng.normal(0, 0.1, photo.shape)).astype(np.float32)
    return picture, photo


# Wider than a vector, narrower than the window, lower than a band, with bands that are cut short.
@pytest.mark.parametrize(("width", "height"), [(61, 103), (7, 6), (8, 48), (40, 49)])
def test_loss_and_gradient_are_torchs(width, height):
    picture, photo = _pictures(width, height)
    mine = photo_loss(picture, photo, ssim_weight=0.3)
    x = torch.tensor(picture, dtype=torch.float64, requires_grad=True)
    y = torch.tensor(photo, dtype=torch.float64)
    truth = reference.loss(x, None, y, ssim_weight=0.3)
    truth.backward()
    assert mine.value == pytest.approx(truth.item(), rel=1e-5)
    assert mine.ssim == pytest.approx(reference.ssim(x, y).item(), abs=1e-5)
    gradient = x.grad.numpy()
    assert np.linalg.norm(mine.gradient - gradient) < 1e-4 * np.linalg.norm(gradient)


def test_similarity_is_scikit_images():
    picture, photo = _pictures(90, 70)
    inner = np.zeros((70, 90), dtype=bool)
    inner[12:-12, 12:-12] = True  # At the edges windows are cut off in one way or another.
    picture = np.where(inner, picture, photo)
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, truth = structural_similarity(
        picture, photo, data_range=1.0, channel_axis=0, full=True, **options
    )
    assert 0.5 < truth.mean() < 0.95
    assert photo_loss(picture, photo).ssim == pytest.approx(truth.mean(), abs=1e-5)


def test_equal_pictures_have_no_loss_and_no_gradient():
    _, photo = _pictures(50, 40)
    mine = photo_loss(photo.copy(), photo)
    assert mine.ssim == pytest.approx(1.0, abs=1e-6)
    assert mine.value == pytest.approx(0.0, abs=1e-6)
    assert np.abs(mine.gradient).max() < 1e-3 / photo.size


def test_no_bit_of_the_loss_depends_on_the_number_of_threads():
    picture, photo = _pictures(90, 120)
    one, two = (photo_loss(picture, photo, workers=Threads(n)) for n in (1, 2))
    assert (one.value, one.l1, one.ssim) == (two.value, two.l1, two.ssim)
    assert (one.gradient == two.gradient).all()


def test_depth_counts_where_it_is_known():
    rng = np.random.default_rng(3)
    inverse, target, confidence = rng.random((3, 20, 30), dtype=np.float32)
    confidence[:5] = 0.0
    value, gradient = depth_loss(inverse, target, confidence, 0.7)
    x = torch.tensor(inverse, dtype=torch.float64, requires_grad=True)
    truth = 0.7 * (torch.tensor(confidence) * (x - torch.tensor(target)).abs()).mean()
    truth.backward()
    assert value == pytest.approx(truth.item(), rel=1e-6)
    assert gradient == pytest.approx(x.grad.numpy(), rel=1e-5)
    assert (gradient[:5] == 0).all()


def test_psnr_of_a_tenth_everywhere_is_twenty():
    photo = np.full((3, 4, 5), 0.5, dtype=np.float32)
    assert psnr(photo + 0.1, photo) == pytest.approx(20.0, abs=1e-4)
    assert psnr(np.full_like(photo, 7.0), np.ones_like(photo)) == 120.0
