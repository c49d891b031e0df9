"""For tests of what extends nw-eval: a clock, a policy and a world that do as they are told.

    from nw_eval.testing import FakePolicy, GlidingWorld, trial_setup

A trial with them is an ordinary one: `FakePolicy` is an object as `nw_eval.evaluate` takes it,
`GlidingWorld` has all readings of `World`, whose robot it moves without physics.
"""

from nw_eval.testing.fakes import (
    FakeClock,
    FakePolicy,
    GlidingWorld,
    fake_card,
    gliding_world,
    moment_of,
    trial_setup,
)

__all__ = [
    "FakeClock",
    "FakePolicy",
    "GlidingWorld",
    "fake_card",
    "gliding_world",
    "moment_of",
    "trial_setup",
]
