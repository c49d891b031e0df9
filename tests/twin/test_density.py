"""How Gaussians come and go, against the formulas of the two papers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from splat_rooms import cloud

from nw_splat.camera import Camera
from nw_splat.gaussians import ARRAYS, Gaussians
from nw_twin.gaussians.config import Default, Mcmc
from nw_twin.gaussians.density import (
    DefaultDensity,
    McmcDensity,
    Population,
    floaters,
    relocated,
    split,
)
from nw_twin.gaussians.images import Gradients, Photo
from nw_twin.gaussians.kernels.rows import perturb

CAMERA = Camera.from_fovy(width=200, height=100, fovy=1.0, T_world_camera=np.eye(4))
SMALL, LARGE = math.log(0.05), math.log(0.5)


def _row(n, *, log_scale=SMALL, opacity=0.5):
    """Gaussians in a row, no two alike."""
    return Gaussians(
        means=np.arange(3 * n).reshape(n, 3),
        log_scales=np.full((n, 3), log_scale),
        quats=np.tile([1.0, 0.2, -0.1, 0.3], (n, 1)),
        opacity_logits=np.full(n, math.log(opacity / (1 - opacity))),
        sh=np.zeros((n, 4, 3)),
    )


def _pull(centres, visible=None):
    n = len(centres)
    zeros = {name: np.zeros_like(getattr(_row(n), name)) for name in ARRAYS}
    visible = np.ones(n, dtype=bool) if visible is None else np.asarray(visible)
    return Gradients(**zeros, centres=np.asarray(centres, dtype=np.float32), visible=visible)


def _density(n, *, most=1000, **settings):
    return DefaultDensity(Default(**settings), extent=10.0, most=most, count=n)


def _generator():
    return np.random.default_rng(4)


def test_pull_is_the_mean_over_views_of_the_gradient_in_half_images():
    density = _density(2)
    density.observe(_pull([[3e-4, 0.0], [0.0, 2e-4]]), CAMERA)
    density.observe(_pull([[0.0, 0.0], [0.0, 4e-4]], [False, True]), CAMERA)
    mean = density.pull / density.views
    # Half images are 100 pixels wide and 50 high.
    assert mean == pytest.approx([3e-2, (1e-2 + 2e-2) / 2])


def test_small_ones_are_cloned_and_large_ones_are_split_where_the_pull_is_above_the_threshold():
    row = _row(4)
    row.log_scales[2:] = LARGE  # Above 0.01 of 10 m; the others are below.
    density, population = _density(4), Population(row)
    # 2e-4 in half images of 100 pixels is 2e-6 for each pixel.
    density.observe(_pull([[3e-6, 0], [1e-6, 0], [3e-6, 0], [1e-6, 0]]), CAMERA)
    density.after(population, 600, 0.0, _generator())
    g = population.gaussians
    assert len(g) == 6
    assert (g.means[:3] == row.means[[0, 1, 3]]).all()  # Who was split is gone.
    assert (g.means[3] == row.means[0]).all()
    assert np.exp(g.log_scales[4:]) == pytest.approx(0.5 / 1.6)
    assert (density.pull == np.zeros(6)).all()


def test_parts_of_a_split_are_drawn_from_what_was_split():
    rng = np.random.default_rng(0)
    axes = np.log([0.5, 0.1, 0.02])
    one = replace(_row(1), log_scales=axes[None], quats=rng.normal(size=(1, 4)))
    many = one.take(np.zeros(40_000, dtype=np.int64))
    offsets = (split(many, 1.6, _generator()).means - one.means).astype(np.float64)
    turn = Rotation.from_quat(one.quats[0], scalar_first=True).as_matrix()
    wanted = turn @ np.diag(np.exp(2 * axes)) @ turn.T
    found = offsets.T @ offsets / len(offsets)
    assert np.abs(found - wanted).max() < 0.02 * wanted.max()


@pytest.mark.parametrize(
    ("iteration", "left"),
    [(500, 3), (600, 2), (650, 3), (3100, 1), (15_000, 3)],
    ids=["not yet", "faint", "between", "large after a reset", "no more"],
)
def test_the_faint_are_removed_and_the_large_after_the_first_reset(iteration, left):
    row = _row(3)
    row.opacity_logits[0] = math.log(0.004 / 0.996)
    row.log_scales[1, 2] = math.log(1.1)  # A tenth of 10 m is 1 m.
    population = Population(row)
    _density(3).after(population, iteration, 0.0, _generator())
    assert len(population) == left


def test_what_is_far_beyond_the_cameras_is_large_by_its_distance_from_them():
    row = _row(3)
    row.log_scales[:] = math.log(3.0)  # 1 m is large near the cameras, 10 m at a hundred metres.
    row.means[0] += (100.0, 0.0, 0.0)
    middle = row.means[1].astype(float)
    density = DefaultDensity(Default(), extent=10.0, most=100, count=3, middle=middle)
    population = Population(row)
    density.after(population, 3100, 0.0, _generator())
    assert (population.gaussians.means == row.means[:1]).all()


def of_a_wall(depth=3.0, confidence=1.0):
    """Return three photographs, side by side, of a wall."""
    size = {"width": 40, "height": 30, "fx": 30.0, "fy": 30.0, "cx": 20.0, "cy": 15.0}
    found = []
    for x in (-0.2, 0.0, 0.2):
        pose = np.eye(4)
        pose[0, 3] = x
        found.append(
            Photo(
                name=f"{x}.png",
                camera=Camera(**size, T_world_camera=pose),
                rgb=np.zeros((30, 40, 3), np.uint8),
                inverse_depth=np.full((30, 40), 1.0 / depth, np.float32),
                confidence=np.full((30, 40), confidence, np.float32),
            )
        )
    return found


def test_what_photographs_look_through_floats_and_what_they_see_or_cannot_see_does_not():
    places = np.float32([[0, 0, 1], [0, 0, 2], [0, 0, 2.9], [0, 0, 3.1], [0, 0, 9], [0, 0, -1]])
    photos = of_a_wall()
    assert floaters(places, photos, 10.0).tolist() == [True, True, False, False, False, False]
    assert floaters(places, photos, 1.5).tolist() == [True, False, False, False, False, False]
    assert not floaters(places, of_a_wall(confidence=0.1), 10.0).any()
    assert not floaters(places, [replace(p, inverse_depth=None) for p in photos], 10.0).any()
    # Two that see a surface there are worth more than one that looks through.
    seen = [replace(p, inverse_depth=np.full((30, 40), 0.5, np.float32)) for p in photos[:2]]
    assert not floaters(places[1:2], [*seen, photos[2]], 10.0).any()


def test_nothing_floats_before_the_edge_of_something_near():
    photo = of_a_wall()[1]
    photo.inverse_depth[:, 21:] = 1.0  # A post one metre ahead, whose edge may be a pixel off.
    beside = np.float32([[0.02, 0, 1.0], [-0.1, 0, 1.0]])  # In columns 20 and 17.
    assert floaters(beside, [photo], 10.0).tolist() == [False, True]


def test_what_is_in_front_of_the_sky_floats_but_not_the_sky():
    photos = of_a_wall()
    for photo in photos:
        photo.inverse_depth[:] = 0.0
    assert floaters(np.float32([[0, 0, 2], [0, 0, 200]]), photos, 10.0).tolist() == [True, False]


def test_what_one_photograph_alone_shows_much_nearer_than_all_it_knows_floats():
    photos = of_a_wall(confidence=0.1)  # Too unsure to look through anything.
    places = np.float32([[0.75, 0, 1.0], [0.75, 0, 2.0], [0.0, 0.0, 1.0]])
    assert floaters(places, photos, 10.0).tolist() == [True, False, False]


def test_opacities_are_reset_to_a_hundredth():
    population = Population(_row(3))
    _density(3).after(population, 3000, 0.0, _generator())
    assert population.opacities() == pytest.approx(0.01, rel=1e-5)


def test_no_more_come_than_there_may_be_and_those_pulled_most_come_first():
    density, population = _density(4, most=5), Population(_row(4))
    density.observe(_pull([[3e-6, 0], [9e-6, 0], [5e-6, 0], [4e-6, 0]]), CAMERA)
    density.after(population, 600, 0.0, _generator())
    assert len(population) == 5
    assert (population.gaussians.means[4] == _row(4).means[1]).all()


def _paper_factor(opacity, number):
    """Equation 9 of Kheradmand et al. 2024 as it stands there, with its double sum."""
    shared = 1 - (1 - opacity) ** (1 / number)
    total = sum(
        math.comb(i - 1, k) * (-1) ** k / math.sqrt(k + 1) * shared ** (k + 1)
        for i in range(1, number + 1)
        for k in range(i)
    )
    return opacity / total


@pytest.mark.parametrize("number", [1, 2, 3, 7, 20])
@pytest.mark.parametrize("opacity", [0.05, 0.5, 0.95])
def test_many_in_the_place_of_one_are_as_the_paper_says_and_cover_as_much(number, opacity):
    shared, factor = (v[0] for v in relocated(np.array([opacity]), np.array([number])))
    assert shared == pytest.approx(1 - (1 - opacity) ** (1 / number))
    assert factor == pytest.approx(_paper_factor(opacity, number), rel=1e-6)
    # What the formula is for: along a line through the centre, the same light is kept in all.
    x = np.linspace(-12, 12, 20_001)
    one = opacity * np.exp(-(x**2) / 2)
    all_of_them = 1 - (1 - shared * np.exp(-(x**2) / (2 * factor**2))) ** number
    assert all_of_them.sum() == pytest.approx(one.sum(), rel=1e-4)


def test_the_dead_move_to_the_living_and_share_their_opacity():
    row = _row(40, opacity=0.8)
    row.opacity_logits[:10] = math.log(0.004 / 0.996)
    population = Population(row)
    McmcDensity(Mcmc(noise=0.0), most=40).after(population, 600, 0.0, _generator())
    g = population.gaussians
    assert len(population) == 40
    living = {tuple(mean) for mean in row.means[10:]}
    assert all(tuple(mean) in living for mean in g.means[:10])
    for mean in {tuple(mean) for mean in g.means[:10]}:
        here = (g.means == mean).all(axis=1)
        shared, factor = relocated(np.array([0.8]), np.array([here.sum()]))
        assert population.opacities()[here] == pytest.approx(shared[0], rel=1e-4)
        assert np.exp(g.log_scales[here]) == pytest.approx(0.05 * factor[0], rel=1e-4)


def test_a_twentieth_more_come_each_time_up_to_the_most():
    population = Population(_row(100))
    density = McmcDensity(Mcmc(noise=0.0), most=108)
    for iteration, count in ((500, 100), (600, 105), (650, 105), (700, 108), (25_000, 108)):
        density.after(population, iteration, 0.0, _generator())
        assert len(population) == count
    assert (population.moments[0].means == 0).all()


def test_noise_has_the_shape_of_each_gaussian_and_leaves_the_opaque_alone():
    n = 30_000
    axes = np.log([0.5, 0.1, 0.02])
    g = _row(n)
    g.log_scales[:] = axes
    g.quats[:] = [1, 0, 0, 0]
    g.means[:] = 0.0
    g.opacity_logits[: n // 2] = math.log(0.001 / 0.999)
    noise = np.random.default_rng(1).standard_normal((n, 3), dtype=np.float32)
    perturb(g.means, g.log_scales, g.quats, g.opacity_logits, noise, 2.0)
    curve = 1 / (1 + math.exp(-100 * ((1 - 0.001) - 0.995)))
    wanted = 2.0 * curve * np.exp(2 * axes) * noise[: n // 2]
    assert g.means[: n // 2] == pytest.approx(wanted, rel=1e-4)
    assert np.abs(g.means[n // 2 :]).max() < 1e-20


def test_turned_gaussians_are_shaken_along_their_own_axes():
    g = cloud(5, degree=0)
    before = g.means.copy()
    logits = np.full(5, -10.0, dtype=np.float32)
    noise = np.random.default_rng(1).standard_normal((5, 3), dtype=np.float32)
    perturb(g.means, g.log_scales, g.quats, logits, noise, 1.0)
    for i in range(5):
        turn = Rotation.from_quat(g.quats[i], scalar_first=True).as_matrix()
        curve = 1 / (1 + math.exp(100 * (1 / (1 + math.exp(10)) - 0.005)))
        moved = curve * turn @ np.diag(np.exp(2 * g.log_scales[i])) @ turn.T @ noise[i]
        assert g.means[i] - before[i] == pytest.approx(moved, rel=1e-3, abs=1e-6)


def test_weights_on_opacity_and_size_have_the_gradients_of_means():
    population = Population(cloud(30, degree=0))
    gradients = _pull(np.zeros((30, 2)))
    density = McmcDensity(Mcmc(), most=30)
    value = density.weigh(population, gradients)
    step = 1e-2
    for name, place in (("opacity_logits", (3,)), ("log_scales", (5, 1))):
        array = getattr(population.gaussians, name)
        slope = float(getattr(gradients, name)[place])
        array[place] += step
        more = density.weigh(population, _pull(np.zeros((30, 2))))
        array[place] -= step
        assert (more - value) / step == pytest.approx(slope, rel=0.02)
