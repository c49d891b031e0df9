"""The numbers of the two strategies, as their papers' code has them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Default:
    """Kerbl et al. 2023, section 5 and algorithm 1.

    Attributes:
        first: step after which Gaussians come and go.
        last: step before which that ends.
        every: steps from one time to the next.
        reset_every: steps from one reset of opacities to the next.
        gradient: mean gradient of the screen position, in half images, above which one grows.
        small: largest standard deviation that is cloned, in sizes of the capture; the others split.
        shrink: factor by which the two parts of a split one are smaller.
        faint: opacity below which one is removed; a reset leaves at most twice as much.
        large: standard deviation above which one is removed after the first reset, in sizes of the
            capture.
    """

    first: int = 500
    last: int = 15_000
    every: int = 100
    reset_every: int = 3000
    gradient: float = 2e-4
    small: float = 0.01
    shrink: float = 1.6
    faint: float = 0.005
    large: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Mcmc:
    """Kheradmand et al. 2024, sections 3 and 4.

    Attributes:
        first: step after which dead Gaussians move and new ones come.
        last: step before which that ends; noise goes on.
        every: steps from one time to the next.
        growth: factor by which the number grows each time, up to the most there may be.
        dead: opacity at which one is dead.
        noise: rate of the noise, as a multiple of the rate of the means.
        opacity_weight: of the mean opacity in the loss.
        scale_weight: of the mean standard deviation in the loss.
    """

    first: int = 500
    last: int = 25_000
    every: int = 100
    growth: float = 1.05
    dead: float = 0.005
    noise: float = 5e5
    opacity_weight: float = 0.01
    scale_weight: float = 0.01
