"""What every observation of a card has: a rate, a latency, noise, and a chain of wrappers."""

from __future__ import annotations

from pydantic import Field

from nw_eval.cards.model import CONTROL_RATE, CardModel, Latency, Rate
from nw_eval.cards.observations.wraps import Noise, Wrap


class BaseObservation(CardModel):
    """Sampled at a rate, delivered after a latency.

    A sample is measured, gets its noise, is brought into the form that the card asks for (points
    of a scanner, stacks, earlier frames) and then passes through the wrappers in order.
    """

    rate: Rate = CONTROL_RATE
    """Samples per second; between two of them the last one is held."""
    latency: Latency = 0.0
    """Age of a sample when the policy first sees it, s."""
    noise: Noise | None = None
    """Of the measurement, drawn from the trial's own stream for this observation."""
    wrap: list[Wrap] = Field(default_factory=list[Wrap], max_length=20)
    """What happens to a sample before the policy sees it, in this order."""
