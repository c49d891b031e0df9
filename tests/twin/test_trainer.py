"""Training as a whole: it learns the place, and repeats to the bit."""

from dataclasses import replace

import numpy as np
import pytest
from small_capture import PLACE, beginning, photos

from nw_base.errors import SceneError, UsageError
from nw_splat.camera import Camera
from nw_splat.gaussians import ARRAYS
from nw_twin.gaussians.config import Default, Mcmc, Rates, TrainConfig, falling
from nw_twin.gaussians.images import Photo, extent_of
from nw_twin.gaussians.loss import psnr
from nw_twin.gaussians.rasteriser import Rasteriser
from nw_twin.gaussians.trainer import Trainer

BUSY = TrainConfig(
    iterations=60,
    sh_every=20,
    most=1200,
    default=Default(first=5, last=50, every=10, reset_every=40),
    mcmc=Mcmc(first=5, last=50, every=10),
)
"""Everything that happens in a training happens in these few steps."""


def _held_out(gaussians, views, background=(1.0, 1.0, 1.0)):
    rasteriser = Rasteriser(background=background)
    return np.mean(
        [psnr(rasteriser.render(gaussians, view.camera).rgb, view.planes()) for view in views]
    )


def _same(one, other):
    return all((getattr(one, name) == getattr(other, name)).all() for name in ARRAYS)


@pytest.mark.parametrize("strategy", ["default", "mcmc", "fixed"])
def test_training_shows_views_that_it_was_not_told(strategy):
    start = beginning(size=0.6, opacity=0.3)
    config = replace(BUSY, iterations=200, strategy=strategy, exposure=False)
    trainer = Trainer(photos(12), start, config)
    steps = []
    trainer.run(report=steps.append)
    views = photos(5, first=0.5)
    assert _held_out(trainer.gaussians, views) > _held_out(start, views) + 3.0
    assert np.mean([s.loss for s in steps[-12:]]) < 0.7 * np.mean([s.loss for s in steps[:12]])
    assert steps[-1].count == len(trainer.gaussians)
    assert (steps[-1].count > len(start)) == (strategy != "fixed")


@pytest.mark.parametrize("strategy", ["default", pytest.param("mcmc", marks=pytest.mark.nightly)])
def test_the_same_seed_gives_the_same_bits_with_any_number_of_threads(strategy):
    taken = photos(depth=True)
    results = []
    for seed, threads in ((0, 1), (0, 2), (1, 1)):
        config = replace(BUSY, strategy=strategy, seed=seed)
        trainer = Trainer(taken, beginning(degree=1), config, threads=threads)
        trainer.run()
        results.append(trainer)
    assert _same(results[0].gaussians, results[1].gaussians)
    assert (results[0].exposures.maps == results[1].exposures.maps).all()
    assert len(results[0].gaussians) != len(results[2].gaussians) or not _same(
        results[0].gaussians, results[2].gaussians
    )


def test_every_photograph_has_its_turn_before_one_comes_again():
    trainer = Trainer(photos(), beginning(), replace(BUSY, strategy="fixed"))
    steps = []
    trainer.run(18, report=steps.append)
    turns = [[step.photo for step in steps[i : i + 6]] for i in (0, 6, 12)]
    assert all(sorted(turn) == list(range(6)) for turn in turns)
    assert len({tuple(turn) for turn in turns}) > 1


def test_the_first_steps_learn_from_pictures_of_half_the_size_and_the_rest_from_whole_ones():
    taken, config = photos(depth=True), replace(BUSY, iterations=20, coarse=0.4)
    halves = [photo.halved() for photo in taken]
    coarse = Trainer(taken, beginning(), config)
    fine = Trainer(halves, beginning(), replace(config, coarse=0.0))
    coarse.run(8)
    fine.run(8)
    assert _same(coarse.gaussians, fine.gaussians)
    coarse.run(9)
    fine.run(9)
    assert not _same(coarse.gaussians, fine.gaussians)


def test_a_picture_of_half_the_size_shows_the_same_place_with_means_of_four_pixels():
    (photo, *_) = photos(depth=True)
    odd = replace(photo.camera, width=71, height=47)
    mask = np.ones((47, 71), bool)
    mask[7, 9] = False
    rgb = photo.rgb[:47, :71].copy()
    photo = replace(photo, camera=odd, rgb=rgb, inverse_depth=None, mask=mask)
    half = photo.halved()
    assert np.argwhere(~half.mask).tolist() == [[3, 4]], "one of its four is no part of the place"
    assert half.rgb.shape == (23, 35, 3)
    assert half.rgb[3, 4].tolist() == pytest.approx(
        photo.rgb[6:8, 8:10].reshape(4, 3).mean(axis=0).tolist(), abs=0.5
    )
    # The middle of its pixel is the corner at which the four meet.
    ways = [
        ((column - c.cx) / c.fx, (row - c.cy) / c.fy)
        for c, column, row in ((odd, 10.0, 8.0), (half.camera, 5.0, 4.0))
    ]
    assert ways[0] == pytest.approx(ways[1])


def test_harmonics_begin_with_the_constant_and_come_degree_by_degree():
    config = replace(BUSY, strategy="fixed", exposure=False)
    trainer = Trainer(photos(), beginning(degree=2), config)
    for until, used in ((20, 1), (40, 4), (60, 9)):
        trainer.run(until)
        assert (trainer.gaussians.sh[:, :used] != 0).any(axis=(0, 2)).all()
        assert (trainer.gaussians.sh[:, used:] == 0).all()


def test_depth_that_is_known_makes_the_place_deeper_than_pictures_alone():
    taken = photos(depth=True)
    error = {}
    for weight in (0.0, 1.0):
        config = replace(
            BUSY, iterations=120, strategy="fixed", depth_weight=weight, depth_weight_last=weight
        )
        trainer = Trainer(taken, beginning(), config)
        trainer.run()
        rasteriser = Rasteriser()
        error[weight] = np.mean(
            [
                np.abs(
                    rasteriser.render(trainer.gaussians, photo.camera).inverse_depth
                    - photo.inverse_depth
                ).mean()
                for photo in taken
            ]
        )
    assert error[1.0] < 0.75 * error[0.0]


def test_photographs_of_different_exposure_agree_once_each_has_its_own():
    black = (0.0, 0.0, 0.0)
    taken = photos(gains=(0.7, 1.0), background=black)
    # The mean exposure, which is the place's.
    views = photos(5, first=0.5, gains=(0.85,), background=black)
    quality = {}
    for exposure in (False, True):
        config = replace(BUSY, iterations=150, strategy="fixed", exposure=exposure)
        config = replace(config, rates=Rates(exposure=2e-2), background=black)
        trainer = Trainer(taken, PLACE, config)
        trainer.run()
        quality[exposure] = _held_out(trainer.gaussians, views, black)
    assert quality[True] > quality[False] + 3.0
    grey = np.full((3, 1, 1), 0.5, dtype=np.float32)
    shown = [trainer.exposures.apply(number, grey).mean() for number in range(6)]
    assert np.mean(shown[::2]) / np.mean(shown[1::2]) == pytest.approx(0.7, abs=0.06)
    assert trainer.exposures.maps.mean(axis=0) == pytest.approx(np.eye(3, 4), abs=1e-6)


def test_what_a_mask_hides_is_not_learnt():
    taken = photos(1)[0]
    mask = np.zeros((48, 72), dtype=bool)
    mask[:, :36] = True
    spoilt = taken.rgb.copy()
    spoilt[:, 36:] = 255 - spoilt[:, 36:]
    results = []
    for rgb in (taken.rgb, spoilt):
        trainer = Trainer([replace(taken, rgb=rgb, mask=mask)], beginning(), BUSY)
        trainer.run(5)
        results.append(trainer.gaussians)
    assert _same(*results)
    assert not _same(results[0], beginning())


def test_the_background_is_what_the_config_says():
    far = replace(beginning(), means=beginning().means + 1000)
    dark = replace(BUSY, background=(0.0, 0.0, 0.0), exposure=False)
    picture = photos(1)[0].planes()
    assert Trainer(photos(1), far, dark).step().l1 == pytest.approx(picture.mean(), rel=1e-4)


def test_a_training_that_diverges_says_where():
    start = beginning()
    start.sh[:] = np.inf
    with pytest.raises(SceneError, match=r"diverged at step 1, on 0\d.png"):
        Trainer(photos(), start, BUSY).step()


def test_a_training_of_nothing_is_refused():
    with pytest.raises(UsageError, match="0 photographs"):
        Trainer([], beginning(), BUSY)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"iterations": 0}, "iterations is 0"),
        ({"coarse": 1.5}, "coarse is 1.5"),
        ({"ssim_weight": 1.5}, "ssim_weight is 1.5"),
        ({"seed": -1}, "seed is -1"),
        ({"depth_weight": -0.1}, "depth weight is -0.1"),
        ({"rates": Rates(quats=float("nan"))}, "quats is nan"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(options, words):
    with pytest.raises(UsageError, match=words):
        TrainConfig(**options)


def test_no_gaussian_near_the_cameras_is_wider_than_it_may_be():
    taken = photos()
    eyes = np.array([photo.camera.T_world_camera[:3, 3] for photo in taken])
    trainer = Trainer(taken, beginning(), replace(BUSY, strategy="fixed", widest=0.02))
    beyond = trainer.gaussians.means[:30]
    beyond[:, 0] += 100.0  # Far from all cameras.
    wide = float(np.exp(trainer.gaussians.log_scales.max()))
    trainer.run()
    means, sizes = trainer.gaussians.means, np.exp(trainer.gaussians.log_scales.max(axis=1))
    away = np.linalg.norm(means[:, None] - eyes, axis=2).min(axis=1)
    near = away < trainer.extent
    assert wide > 0.1
    assert (sizes[near] <= 0.02 * away[near] * 1.001).all()
    assert sizes[:30].max() > 0.1


def test_a_short_training_keeps_the_shares_of_the_papers_schedules():
    config = TrainConfig.short(3000)
    assert (config.default.first, config.default.last, config.default.every) == (50, 1500, 100)
    assert (config.mcmc.first, config.mcmc.last, config.sh_every) == (50, 2500, 100)
    assert config.default.reset_every == 1000
    assert TrainConfig.short(30_000) == TrainConfig()
    assert falling(1e-2, 1e-4, 0.5) == pytest.approx(1e-3)


def test_a_photograph_of_another_size_than_its_cameras_is_refused():
    camera = Camera.from_fovy(width=8, height=6, fovy=1.0, T_world_camera=np.eye(4))
    rgb = np.zeros((6, 8, 3), dtype=np.uint8)
    with pytest.raises(UsageError, match=r"a.png: the picture is float64"):
        Photo(name="a.png", camera=camera, rgb=rgb.astype(np.float64))
    with pytest.raises(UsageError, match=r"a.png: confidence has shape \(8, 6\)"):
        Photo(name="a.png", camera=camera, rgb=rgb, confidence=np.ones((8, 6), dtype=np.float32))


def test_the_size_of_a_capture_is_a_little_more_than_its_farthest_camera():
    assert extent_of(photos(6)) == pytest.approx(1.1 * 4.0, rel=0.02)
    assert extent_of(photos(1)) == 1.0
