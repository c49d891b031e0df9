"""Saving and restoring a world in the middle of a trial."""

import numpy as np
import pytest

from nw_base.errors import TrialError
from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_sim.physics import World


@pytest.fixture
def bumpy(place):
    return place(((0.45, 0.0, 0.04), (0.08, 0.5, 0.04)), ((-0.4, 0.3, 0.03), (0.1, 0.1, 0.03)))


def run(world, swing, steps):
    seen = []
    for step in steps:
        world.step(swing(step))
        seen.append(
            b"".join(
                [
                    world.state(),
                    world.foot_forces().tobytes(),
                    world.torques.tobytes(),
                    world.previous_foot_contacts.tobytes(),
                    world._data.xpos.tobytes(),
                    world._data.subtree_com.tobytes(),
                    np.float64(world.time).tobytes(),
                ]
            )
        )
    return seen


@pytest.mark.parametrize("protocol", [STRICT, NEVERWHERE_2026])
def test_a_restored_world_has_the_same_future_bit_for_bit(go1, bumpy, swing, protocol):
    with World(go1, bumpy, protocol=protocol) as world:
        # Step 8 is in the middle of touch-down, where forces change most.
        run(world, swing, range(8))
        middle = world.state()
        forces = world.foot_forces()
        assert forces.max() > 2.0
        future = run(world, swing, range(8, 80))

        world.restore(middle)
        assert world.state() == middle
        np.testing.assert_array_equal(world.foot_forces(), forces)
        assert world.steps == 8
        assert run(world, swing, range(8, 80)) == future

    with World(go1, bumpy, protocol=protocol) as another:
        another.restore(middle)
        assert run(another, swing, range(8, 80)) == future


def test_restoring_clears_a_failure(go1, bumpy, swing):
    with World(go1, bumpy) as world:
        run(world, swing, range(5))
        good = world.state()
        world._data.qvel[0] = 1e12
        with pytest.raises(TrialError):
            world.step(swing(5))
        world.restore(good)
        run(world, swing, range(5, 10))


def test_damaged_states_are_refused(go1, flat):
    with World(go1, flat) as world:
        state = world.state()
        for damaged in (b"", state[:-1], state + b"\0", b"XXXX" + state[4:]):
            with pytest.raises(TrialError, match="cannot restore a state of"):
                world.restore(damaged)


def test_states_of_other_worlds_are_refused(go1, flat, bumpy):
    with World(go1, flat) as world:
        state = world.state()
    others = [{"payload": 1.0}, {"friction": 0.8}, {"protocol": NEVERWHERE_2026}]
    for options in others:
        with World(go1, flat, **options) as other, pytest.raises(TrialError):
            other.restore(state)
    with World(go1, bumpy) as other, pytest.raises(TrialError, match="state of another model"):
        other.restore(state)
