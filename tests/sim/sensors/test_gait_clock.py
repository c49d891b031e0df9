"""The clock of a card, against plain re-writings of the published ones."""

import numpy as np
import pytest

from nw_sim.sensors import build_sensors
from nw_sim.sensors.build import check_card

STEPS = 120
DT = 0.02


@pytest.fixture
def ticks(world, card_of, moment_of):
    """A function: what a clock reads at every control step, (STEPS, n)."""

    def ticks(**term):
        fields = {"command": term.pop("command")} if "command" in term else {}
        observation = {"sensor": "proprio", "terms": [{"term": "clock", **term}]}
        card = card_of({"o": observation}, **fields)
        sensor = build_sensors(card, world)["o"]
        sensor.reset(0)
        read = np.array([sensor.read(moment_of(world, step=step)) for step in range(STEPS)])
        (spec,) = check_card(card)
        assert read.shape[1:] == spec.shape
        return read

    return ticks


def walk_these_ways(frequency, phase, offset, bound, duration):
    """`clock_inputs` by LeggedRobot._step_contact_targets, feet FL FR RL RR."""
    gait, found = 0.0, []
    for step in range(STEPS):
        if step:
            gait = np.remainder(gait + DT * frequency, 1.0)
        feet = np.remainder(
            [gait + phase + offset + bound, gait + offset, gait + bound, gait + phase], 1.0
        )
        stance, swing = feet < duration, feet > duration
        warped = feet.copy()
        warped[stance] = feet[stance] * (0.5 / duration)
        warped[swing] = 0.5 + (feet[swing] - duration) * (0.5 / (1 - duration))
        found.append(np.sin(2 * np.pi * warped))
    return np.array(found)


@pytest.mark.parametrize(
    ("frequency", "phase", "offset", "bound", "duration"),
    [
        (3.0, 0.5, 0.0, 0.0, 0.5),  # trotting
        (2.0, 0.0, 0.5, 0.0, 0.5),  # bounding
        (4.0, 0.0, 0.0, 0.5, 0.5),  # pacing
        (3.1, 0.13, 0.21, 0.37, 0.35),
        # Not 0.71, the first foot's start: a phase of just the duration escapes their stretching.
        (2.3, 0.13, 0.21, 0.37, 0.72),
    ],
)
def test_it_is_the_clock_of_walk_these_ways(ticks, frequency, phase, offset, bound, duration):
    read = ticks(
        frequency=frequency,
        offsets=[phase + offset + bound, offset, bound, phase],
        stance=duration,
        values=["sine"],
    )
    expected = walk_these_ways(frequency, phase, offset, bound, duration)
    # Where a foot stands just between two cycles, 0.99999999 and 0 are the same to a sine.
    np.testing.assert_allclose(read, expected, atol=1e-5)
    assert np.ptp(read, axis=0).min() > 1.5


def test_it_is_the_phase_of_unitree_rl_gym(ticks):
    # sin(2 pi phase), cos(2 pi phase), phase = time % period / period, of a period of 0.8 s.
    phase = np.arange(STEPS) * DT % 0.8 / 0.8
    expected = np.stack([np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase)], axis=1)
    np.testing.assert_allclose(ticks(frequency=1.25), expected, atol=1e-6)


def test_it_is_the_phase_of_playground(ticks):
    # Two feet half a cycle apart, advanced step by step and wrapped; cosines before sines.
    phase, expected = np.array([0.0, np.pi]), []
    for _ in range(STEPS):
        expected.append([*np.cos(phase), *np.sin(phase)])
        phase = np.fmod(phase + 2 * np.pi * DT * 1.5 + np.pi, 2 * np.pi) - np.pi
    read = ticks(frequency=1.5, offsets=[0.0, 0.5], values=["cosine", "sine"])
    np.testing.assert_allclose(read, expected, atol=1e-6)


def test_the_bare_phase_runs_from_zero_to_one(ticks):
    read = ticks(frequency=1.0, offsets=[0.0, 0.75, -0.25], values=["phase"])
    np.testing.assert_allclose(
        read[[0, 10, 40]], [[0, 0.75, 0.75], [0.2, 0.95, 0.95], [0.8, 0.55, 0.55]], atol=1e-6
    )
    assert read.min() >= 0.0
    assert read.max() < 1.0


STILL = {"source": "constant", "velocity": [0.03, 0.0, -0.04]}  # A norm of 0.05.


def test_it_can_read_zeros_while_nothing_is_commanded(ticks):
    # unitree_rl_mjlab: zeros where the norm of the command is below 0.1.
    assert not ticks(frequency=1.25, standing={"below": 0.1}, command=STILL).any()
    running = ticks(frequency=1.25, standing={"below": 0.04}, command=STILL)
    np.testing.assert_array_equal(running, ticks(frequency=1.25))


def test_it_can_rest_at_a_phase_while_nothing_is_commanded(ticks):
    # Playground: both feet at pi.
    clock = {"frequency": 1.5, "offsets": [0.0, 0.5], "values": ["cosine", "sine"]}
    read = ticks(**clock, standing={"below": 0.06, "phase": 0.5}, command=STILL)
    np.testing.assert_allclose(read, [[-1.0, -1.0, 0.0, 0.0]] * STEPS, atol=1e-7)


def test_it_needs_no_memory(world, card_of, moment_of):
    clock = {"term": "clock", "frequency": 2.3, "stance": 0.6}
    card = card_of({"o": {"sensor": "proprio", "terms": [clock]}})
    one, other = (build_sensors(card, world)["o"] for _ in range(2))
    for sensor in (one, other):
        sensor.reset(0)
    for step in range(38):
        last = one.read(moment_of(world, step=step))
    np.testing.assert_array_equal(other.read(moment_of(world, step=37)), last)
