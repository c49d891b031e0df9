"""What the stage that makes the splat is asked to do."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.errors import UsageError
from nw_eval.twin.gaussians.config import Strategy


@dataclass(frozen=True, kw_only=True)
class AppearanceOptions:
    """Options of the splat.

    Attributes:
        iterations: steps of training.
        longest: largest side of the pictures that are learnt from, pixels; larger ones are reduced.
        most: Gaussians that there may be.
        begin: points on the mesh to begin with, three quarters of `most` at most.
        strategy: how Gaussians come and go.
        mesh: whether they begin on the mesh; else at the points that calibration found.
        depth: whether the depths of the reconstruction count.
        held_out_every: every so many-th picture is kept from training, to compare with; 0 = none.
        held_out: a glob of names that are kept from training instead; empty = none are named.
        seed: of all that is drawn.
    """

    iterations: int = 6000
    longest: int = 480
    most: int = 200_000
    begin: int = 100_000
    strategy: Strategy = "default"
    mesh: bool = True
    depth: bool = True
    held_out_every: int = 8
    held_out: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: naming the option, its value and what it must be.
        """
        least = {"iterations": 1, "longest": 32, "most": 100, "begin": 100, "seed": 0}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise UsageError(f"{name} is {getattr(self, name)}", fix=f"give {low} or more")
        if self.held_out_every < 0 or self.held_out_every == 1:
            raise UsageError(
                f"held_out_every is {self.held_out_every}: nothing would be left to learn from",
                fix="give 2 or more, or 0 for none",
            )
