"""Options of a training; its strategies have the constants of their papers' code."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal

from nw_base.errors import UsageError
from nw_base.words import Projection
from nw_splat.camera import PresetName

PAPER_ITERATIONS = 30_000
"""Steps of the 3DGS paper, which its schedules are for."""

Strategy = Literal["default", "mcmc", "fixed"]
"""How Gaussians come and go: by the 3DGS paper, by Kheradmand et al. 2024, or not at all."""


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


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Learning rates, as the 3DGS paper's code has them.

    Those of means and exposures fall exponentially from the first step to the last.

    Attributes:
        means: at first, in sizes of the capture.
        means_last: at last.
        log_scales: of log_scales.
        quats: of quats.
        opacity_logits: of opacity_logits.
        sh_constant: of the constant harmonic.
        sh_others: of the others, a twentieth of it.
        exposure: at first.
        exposure_last: at last.
    """

    means: float = 1.6e-4
    means_last: float = 1.6e-6
    log_scales: float = 5e-3
    quats: float = 1e-3
    opacity_logits: float = 5e-2
    sh_constant: float = 2.5e-3
    sh_others: float = 2.5e-3 / 20.0
    exposure: float = 1e-2
    exposure_last: float = 1e-3


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training. With the same photographs, beginning and config the result has the same bits.

    Attributes:
        iterations: steps, of one photograph each.
        seed: of the order of photographs and of what is sampled.
        strategy: how Gaussians come and go.
        most: Gaussians that there may be.
        sh_every: steps from one degree of harmonics to the next; the first has the constant alone.
        ssim_weight: share of structural similarity in the photometric loss.
        depth_weight: of the inverse depth at the first step.
        depth_weight_last: at the last one; it falls exponentially.
        coarse: share of the steps, the first ones, with pictures of half their size: they cost
            less, and what is large is in place before details are learnt.
        widest: standard deviation that a Gaussian may have, as a share of its distance from the
            nearest camera; 0 = any. What is farther from all than the capture is large has none.
        exposure: whether each photograph gets an affine map of colours.
        rates: of the optimiser.
        default: of that strategy.
        mcmc: of that strategy.
        preset: which gsplat's numerical choices.
        antialiased: whether opacity is compensated for the blur of small splats.
        projection: how Gaussians become pixels, and should be drawn afterwards.
        background: colour behind everything; the shipped renderer's.
    """

    iterations: int = PAPER_ITERATIONS
    seed: int = 0
    strategy: Strategy = "default"
    most: int = 1_000_000
    sh_every: int = 1000
    ssim_weight: float = 0.2
    depth_weight: float = 1.0
    depth_weight_last: float = 0.01
    coarse: float = 0.0
    widest: float = 0.0
    exposure: bool = True
    rates: Rates = field(default_factory=Rates)
    default: Default = field(default_factory=Default)
    mcmc: Mcmc = field(default_factory=Mcmc)
    preset: PresetName = "gsplat-1.5"
    antialiased: bool = True
    projection: Projection = "ray"
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        """Check the numbers; UsageError says what cannot be."""
        for name in ("iterations", "most", "sh_every"):
            if getattr(self, name) < 1:
                raise UsageError(
                    f"training's {name} is {getattr(self, name)}", fix="give 1 or more"
                )
        for owner, names in ((self, ("ssim_weight", "coarse")), (self.rates, _names(self.rates))):
            for name in names:
                value = getattr(owner, name)
                if not 0.0 <= value <= 1.0:
                    raise UsageError(f"training's {name} is {value}", fix="give 0 to 1")
        if self.seed < 0:
            raise UsageError(f"training's seed is {self.seed}", fix="give 0 or more")
        if not 0.0 <= self.widest < 1.0:
            raise UsageError(f"training's widest is {self.widest}", fix="give 0 to 1")
        if min(self.depth_weight, self.depth_weight_last) < 0.0:
            raise UsageError(
                f"training's depth weight is {self.depth_weight} to {self.depth_weight_last}",
                fix="give 0 or more",
            )

    @classmethod
    def short(
        cls, iterations: int, *, seed: int = 0, strategy: Strategy = "default"
    ) -> TrainConfig:
        """Return the papers' schedules for fewer steps: each begins and ends at the same share.

        What happens every so many steps still does, and opacity, which takes some hundred steps to
        come back, is reset every thousand at most.
        """

        def share(steps: int) -> int:
            return max(1, steps * iterations // PAPER_ITERATIONS)

        return cls(
            iterations=iterations,
            seed=seed,
            strategy=strategy,
            sh_every=share(cls.sh_every),
            default=Default(
                first=share(Default.first),
                last=share(Default.last),
                reset_every=max(1000, share(Default.reset_every)),
            ),
            mcmc=Mcmc(first=share(Mcmc.first), last=share(Mcmc.last)),
        )


def falling(first: float, last: float, share: float) -> float:
    """Return what falls exponentially from `first` to `last`, at a share (0 to 1) of the way."""
    if first <= 0.0 or last <= 0.0:
        return first + (last - first) * share
    return float(first * (last / first) ** share)


def _names(owner: Rates) -> tuple[str, ...]:
    return tuple(each.name for each in fields(owner))
