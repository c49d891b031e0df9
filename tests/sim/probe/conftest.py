"""Recordings made by hand, and a rig that hands them out: no policy, no physics."""

import math
from pathlib import Path

import numpy as np
import pytest

from nw_policies.cards import load_card
from nw_sim.probe.recording import Recording, Walk

PERIOD = 0.02
POLICIES = Path(__file__).resolve().parents[3] / "policies"


def walked(
    velocity=(0.0, 0.0, 0.0),
    *,
    seconds=2.0,
    tilt=0.1,
    travelled=1.0,
    outcome=None,
    sees_images=False,
):
    """A recording of a robot at one velocity, (3,), or at one for each step, (T, 3)."""
    steps = round(seconds / PERIOD)
    return Recording(
        observations={},
        actions=np.zeros((steps, 12)),
        targets=np.zeros((steps, 12)),
        positions=np.zeros((steps + 1, 12)),
        torques=np.zeros((steps, 12)),
        torque_limits=np.ones(12),
        tilt=np.full(steps, tilt),
        velocity=np.broadcast_to(np.asarray(velocity, dtype=float), (steps, 3)),
        period=PERIOD,
        travelled=travelled,
        seconds=seconds,
        outcome=outcome,
        inputs=(),
        sees_images=sees_images,
    )


class HandMade:
    """A rig on which `goes(card, seconds)` says what happens; `asked` counts the recordings.

    A trial takes 10 s under cards of which `completes(card)` is true.
    """

    def __init__(self, goes, completes=lambda _card: False):
        self.goes = goes
        self.completes = completes
        self.asked = 0

    def record(self, card, *, seconds, level=math.inf):  # noqa: ARG002 - it leans as it is made.
        self.asked += 1
        return self.goes(card, seconds)

    def walk(self, card):
        return Walk(completed=self.completes(card), seconds=10.0)


def obeys(card, shares=(1.0, 1.0, 1.0), **more):
    """A recording of a robot that reaches shares of what its card commands."""
    constant = card.command.source == "constant"
    asked = card.command.velocity if constant else (card.command.speed, 0.0, 0.0)
    return walked(np.multiply(asked, shares), **more)


@pytest.fixture(scope="session")
def commanded():
    """The card of a policy that sees its command."""
    return load_card(POLICIES / "examples" / "playground-go1" / "policy.yaml")


@pytest.fixture(scope="session")
def uncommanded():
    """The card of a policy that sees none."""
    return load_card(POLICIES / "go1-parkour" / "policy.yaml")


@pytest.fixture(name="walked", scope="session")
def _walked():
    return walked


@pytest.fixture(name="obeys", scope="session")
def _obeys():
    return obeys


@pytest.fixture(scope="session")
def rig_that_says():
    """Return a maker of stages: `rig_that_says(walk, completes)`."""
    return HandMade
