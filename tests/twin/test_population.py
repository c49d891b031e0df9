"""The optimiser against torch's, and the rows that belong together."""

import numpy as np
import pytest
import torch
from splat_rooms import cloud

from nw_splat.gaussians import ARRAYS
from nw_twin.gaussians.config import Rates
from nw_twin.gaussians.density import EPSILON, Population
from nw_twin.gaussians.images import Gradients
from nw_twin.gaussians.rasteriser import Threads


def _gradients(gaussians, seed):
    rng = np.random.default_rng(seed)
    n = len(gaussians)
    arrays = {
        name: (rng.normal(size=getattr(gaussians, name).shape) * 1e-6).astype(np.float32)
        for name in ARRAYS
    }
    centres, visible = np.zeros((n, 2), dtype=np.float32), np.ones(n, dtype=bool)
    return Gradients(**arrays, centres=centres, visible=visible)


def test_steps_are_those_of_torchs_adam_at_each_parameters_rate():
    gaussians, rates = cloud(70, degree=1), Rates()
    population = Population(gaussians)
    leaves = {
        name: torch.tensor(getattr(gaussians, name).copy()) for name in ARRAYS if name != "sh"
    }
    leaves |= {"sh_constant": torch.tensor(gaussians.sh[:, :1].copy())}
    leaves |= {"sh_others": torch.tensor(gaussians.sh[:, 1:].copy())}
    speed = {name: getattr(rates, name) for name in leaves} | {"means": 7e-4}
    groups = [{"params": [leaf], "lr": speed[name]} for name, leaf in leaves.items()]
    adam = torch.optim.Adam(groups, eps=EPSILON)
    for step in range(1, 6):
        gradients = _gradients(gaussians, step)
        population.move(gradients, rates, 7e-4, step, Threads(1 + step % 2))
        for name, leaf in leaves.items():
            harmonics = {"sh_constant": gradients.sh[:, :1], "sh_others": gradients.sh[:, 1:]}
            part = harmonics[name] if name in harmonics else getattr(gradients, name)
            leaf.grad = torch.tensor(part.copy())
        adam.step()
    mine = population.gaussians
    theirs = {name: leaf.numpy() for name, leaf in leaves.items()}
    theirs["sh"] = np.concatenate([theirs.pop("sh_constant"), theirs.pop("sh_others")], axis=1)
    for name in ARRAYS:
        moved = np.abs(theirs[name] - getattr(gaussians, name))
        assert moved.max() > 1e-4
        assert np.abs(getattr(mine, name) - theirs[name]).max() < 2e-3 * moved.max(), name


def test_whoever_is_kept_keeps_its_moments_and_newcomers_have_none():
    gaussians = cloud(10, degree=1)
    population = Population(gaussians)
    population.move(_gradients(gaussians, 1), Rates(), 1e-4, 1, Threads())
    before = population.moments[0].means.copy()
    rows = np.arange(10) % 3 == 0
    population.keep(rows)
    population.append(cloud(3, degree=1))
    assert len(population) == 7
    assert (population.moments[0].means[:4] == before[rows]).all()
    assert (population.moments[1].sh[4:] == 0).all()


def test_a_limit_lowers_opacities_above_it_and_no_others():
    population = Population(cloud(50, degree=0))
    before = population.opacities()
    population.limit_opacity(0.3)
    assert population.opacities() == pytest.approx(np.minimum(before, 0.3), rel=1e-5)


def test_the_gaussians_that_a_training_began_with_stay_as_they_were():
    gaussians = cloud(20, degree=0)
    means = gaussians.means.copy()
    Population(gaussians).move(_gradients(gaussians, 1), Rates(), 1e-2, 1, Threads())
    assert (gaussians.means == means).all()
