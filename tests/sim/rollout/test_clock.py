"""Stage times."""

import time

import pytest

from nw_eval.testing import FakeClock
from nw_sim.rollout.job import StageClock


def test_an_inner_stage_stops_the_outer_one():
    now = FakeClock()
    clock = StageClock(now)
    with clock("log"):
        now.advance(2.0)
        with clock("render"):
            now.advance(6.0)
        now.advance(1.0)
    assert (clock.stages.render, clock.stages.log) == (6.0, 3.0)


def test_sleeping_takes_wall_time_but_no_cpu_time():
    wall, processor = StageClock(), StageClock(time.thread_time)
    with wall("policy"), processor("policy"):
        time.sleep(0.05)
    assert wall.stages.policy >= 0.05
    assert processor.stages.policy < 0.02


def test_a_stage_that_raises_is_still_counted():
    now = FakeClock()
    clock = StageClock(now)

    def fail():
        with clock("physics"):
            now.advance(1.0)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert clock.stages.physics == 1.0
