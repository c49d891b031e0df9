"""The affine map of each photograph's colours."""

import numpy as np
import pytest
import torch

from nw_twin.gaussians.loss import Exposures


def test_the_gradient_of_a_map_is_torchs():
    rng = np.random.default_rng(0)
    exposures = Exposures(2)
    exposures.maps[1] += rng.normal(0, 0.2, (3, 4))
    rgb, gradient = rng.random((2, 3, 9, 7), dtype=np.float32)
    x = torch.tensor(rgb, dtype=torch.float64, requires_grad=True)
    maps = torch.tensor(exposures.maps[1], dtype=torch.float64, requires_grad=True)
    y = torch.einsum("dc,cyx->dyx", maps[:, :3], x) + maps[:, 3, None, None]
    (y * torch.tensor(gradient)).sum().backward()
    assert exposures.apply(1, rgb) == pytest.approx(y.detach().numpy(), rel=1e-5)
    to_rgb, to_map = exposures.back(1, rgb, gradient)
    assert to_rgb == pytest.approx(x.grad.numpy(), rel=1e-4, abs=1e-6)
    assert to_map == pytest.approx(maps.grad.numpy(), rel=1e-5)


def test_a_photographs_step_moves_its_map_against_the_others_and_not_their_mean():
    exposures = Exposures(4)
    exposures.move(1, np.ones((3, 4), dtype=np.float32), 0.01)
    assert exposures.maps[1] == pytest.approx(np.eye(3, 4) - 0.0075, abs=1e-6)
    assert exposures.maps[[0, 2, 3]] == pytest.approx(
        np.tile(np.eye(3, 4) + 0.0025, (3, 1, 1)), abs=1e-6
    )
    assert exposures.steps.tolist() == [0, 1, 0, 0]
