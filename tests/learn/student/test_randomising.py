"""Changes of images in training: none of them without an amount, and each as its name says."""

import pytest
import torch

from nw_learn.student.config import Randomise
from nw_learn.student.train import Randomiser, resampled

NOTHING = {"rotation": 0, "crop": 0, "blur": 0, "colour": 0, "depth_noise": 0, "dropped": 0}


def randomiser(seed=1, **amounts):
    return Randomiser(
        Randomise.model_validate(NOTHING | amounts), torch.Generator().manual_seed(seed)
    )


@pytest.fixture
def images():
    return torch.rand(6, 6, 9, 16, generator=torch.Generator().manual_seed(0))


def test_without_amounts_images_stay_as_they_are(images):
    random = randomiser()
    moved = resampled(images, random.view(6, (9, 16)))
    torch.testing.assert_close(moved, images, atol=1e-5, rtol=0)
    torch.testing.assert_close(random.colours(images), images, atol=1e-5, rtol=0)
    torch.testing.assert_close(random.depths(images), images)


def test_a_quarter_turn_turns_a_square_image_by_a_quarter():
    random = randomiser(rotation=45)
    random._spread = lambda *size: torch.full(size, 2.0)  # Twice the largest: 90 degrees.
    image = torch.zeros(1, 1, 8, 8)
    image[0, 0, 1, 6] = 1.0
    turned = resampled(image, random.view(1, (8, 8)))
    assert turned[0, 0].argmax().item() == 1 * 8 + 1  # From the upper right to the upper left.
    assert turned.max() == pytest.approx(1.0, abs=1e-4)


def test_a_crop_shows_a_part_of_the_image_larger():
    ramp = torch.linspace(0, 1, 16).expand(6, 6, 9, 16)
    shown = resampled(ramp, randomiser(crop=0.4).view(6, (9, 16)))
    spans = (shown[:, 0, 4].amax(1) - shown[:, 0, 4].amin(1)).tolist()
    assert all(0.6 - 0.1 < span <= 1.0 for span in spans)
    assert min(spans) < 0.9


def test_all_images_of_a_stack_are_changed_alike(images):
    same = images[:, :3].repeat(1, 2, 1, 1)
    random = randomiser(rotation=10, crop=0.1, colour=0.5, blur=1.0)
    changed = random.colours(resampled(same, random.view(6, (9, 16))))
    torch.testing.assert_close(changed[:, :3], changed[:, 3:])
    assert (changed - same).abs().max() > 0.05


def test_a_blur_keeps_brightness_and_takes_contrast_of_some_images(images):
    many = images.repeat(10, 1, 1, 1)
    blurred = randomiser(blur=3.0)._blurred(many)
    assert blurred.mean().item() == pytest.approx(many.mean().item(), abs=0.01)
    deviations = blurred.std(dim=(1, 2, 3)) / many.std(dim=(1, 2, 3))
    assert deviations.min() < 0.6
    assert deviations.max() <= 1.0 + 1e-5
    assert 15 < int((deviations > 1.0 - 1e-5).sum()) < 45


def test_a_blur_goes_on_beyond_the_edges():
    even = torch.full((20, 3, 9, 16), 0.7)
    torch.testing.assert_close(randomiser(blur=3.0)._blurred(even), even)


def test_dropped_pixels_of_depth_read_as_nothing():
    depth = torch.full((50, 2, 9, 16), 0.3)
    dropped = randomiser(dropped=0.2).depths(depth)
    shares = (dropped == 1.0).float().mean(dim=(1, 2, 3))
    assert dropped.unique().tolist() == pytest.approx([0.3, 1.0])
    assert 0.05 < shares.mean() < 0.15
    assert shares.max() < 0.3


def test_noise_of_depth_grows_with_depth():
    near, far = (
        randomiser(depth_noise=0.1).depths(torch.full((50, 1, 9, 16), d)).std() for d in (0.1, 0.5)
    )
    assert far / near == pytest.approx(5.0, rel=0.01)


def test_the_same_generator_gives_the_same_images(images):
    amounts = {"rotation": 5, "crop": 0.1, "colour": 0.3, "blur": 1.0}
    one, two, other = (randomiser(seed, **amounts) for seed in (1, 1, 2))
    views = [random.view(6, (9, 16)) for random in (one, two, other)]
    assert torch.equal(one.colours(images), two.colours(images))
    assert torch.equal(views[0], views[1])
    assert not torch.equal(views[0], views[2])
