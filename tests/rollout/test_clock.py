"""Stage times."""

import time

import pytest

from nw_eval.rollout.result import StageClock


def test_an_inner_stage_stops_the_outer_one():
    clock = StageClock()
    with clock("log"):
        time.sleep(0.02)
        with clock("render"):
            time.sleep(0.06)
    assert 0.06 <= clock.stages.render < 0.2
    assert 0.02 <= clock.stages.log < 0.055


def test_sleeping_takes_wall_time_but_no_cpu_time():
    wall, processor = StageClock(), StageClock(time.thread_time)
    with wall("policy"), processor("policy"):
        time.sleep(0.05)
    assert wall.stages.policy >= 0.05
    assert processor.stages.policy < 0.02


def test_a_stage_that_raises_is_still_counted():
    clock = StageClock()

    def fail():
        with clock("physics"):
            time.sleep(0.01)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert clock.stages.physics >= 0.01
