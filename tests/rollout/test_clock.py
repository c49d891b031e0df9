"""Stage times."""

import time

import pytest

from nw_eval.rollout.clock import StageClock


def test_an_inner_stage_stops_the_outer_one():
    clock = StageClock()
    with clock("log"):
        time.sleep(0.02)
        with clock("render"):
            time.sleep(0.06)
    assert 0.06 <= clock.wall.render < 0.2
    assert 0.02 <= clock.wall.log < 0.055


def test_sleeping_takes_wall_time_but_no_cpu_time():
    clock = StageClock()
    with clock("policy"):
        time.sleep(0.05)
    assert clock.wall.policy >= 0.05
    assert clock.cpu.policy < 0.02


def test_a_stage_that_raises_is_still_counted():
    clock = StageClock()

    def fail():
        with clock("physics"):
            time.sleep(0.01)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert clock.wall.physics >= 0.01
