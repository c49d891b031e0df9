"""What every observation of a card has: a rate, a latency, noise, and a chain of wrappers."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from nw_eval.cards.model import CONTROL_RATE, CardModel, Latency, Rate
from nw_eval.cards.observations.wrappers import Noise, Wrapper


class BaseObservation(CardModel):
    """Sampled at a rate, delivered after a latency.

    A sample is measured, gets its noise, is brought into the form that the card asks for (points
    of a scanner, stacks, earlier frames) and then passes through the wrappers in order.
    """

    needs_splat: ClassVar[bool] = False
    """Whether it is a picture of the scene's splat."""

    rate: Rate = CONTROL_RATE
    """Samples per second; between two of them the last one is held."""
    latency: Latency = 0.0
    """Age of a sample when the policy first sees it, s."""
    noise: Noise | None = None
    """Of the measurement, drawn from the trial's own stream for this observation."""
    wrap: list[Wrapper] = Field(default_factory=list[Wrapper], max_length=20)
    """What happens to a sample before the policy sees it, in this order."""
