"""What `nw_eval.testing` lends to tests of extensions does what it says."""

from functools import partial

import numpy as np
import pytest

import nw_eval
from nw_eval.testing import (
    FakeClock,
    FakePolicy,
    GlidingWorld,
    fake_card,
    gliding_world,
    moment_of,
    trial_setup,
)
from nw_sim.axes import AXES
from nw_sim.rollout.job import StageClock


def test_a_clock_goes_on_by_its_tick_and_as_it_is_told():
    clock = FakeClock(tick=0.5)
    assert [clock(), clock()] == [0.0, 0.5]
    clock.advance(2.0)
    assert clock() == 3.0
    stages = StageClock(FakeClock(tick=1.0))
    with stages("physics"):
        pass
    assert stages.stages.physics == 1.0


def test_a_world_glides_with_all_its_readings():
    with gliding_world(velocity=(1.0, 0.5, 0.0)) as world:
        start = world.trunk_position.copy()
        for _ in range(50):
            world.step(np.full(12, 9.0))
        np.testing.assert_allclose(world.trunk_position - start, [1.0, 0.5, 0.0], atol=1e-9)
        np.testing.assert_allclose(world.trunk_linear_velocity, [1.0, 0.5, 0.0], atol=1e-9)
        np.testing.assert_array_equal(world.joint_positions, world.robot.default_pose)
        assert (world.steps, world.time) == (50, pytest.approx(1.0))
        moment = moment_of(world)
        np.testing.assert_array_equal(moment.position, world.trunk_position)
        assert moment.step == 50


def test_a_world_raises_at_the_step_that_it_is_told():
    make = partial(GlidingWorld, raises={2: RuntimeError("a joint broke")})
    with gliding_world() as other, make(other.robot, other.scene) as world:
        world.step(np.zeros(12))
        world.step(np.zeros(12))
        with pytest.raises(RuntimeError, match="a joint broke"):
            world.step(np.zeros(12))
        assert world.steps == 2


def test_a_policy_answers_by_its_step_and_remembers_what_it_saw(tmp_path):
    policy = FakePolicy(lambda step: np.full(12, 0.01 * step))
    run = nw_eval.evaluate(
        policy,
        suite="smoke",
        card=fake_card(),
        trials=1,
        scenes=("hurdles/three_low",),
        record="none",
        out=tmp_path / "run",
    )
    (row,) = run.rows
    assert row.steps == len(policy.seen) > 10
    assert policy.seen[0]["body"].shape == (12,)
    assert policy.seeds[0] == 0, "it is tried once before the run"
    assert len(policy.seeds) == 2


@pytest.mark.parametrize("axis", AXES.values(), ids=lambda axis: axis.name)
def test_every_built_in_axis_changes_a_setup_and_leaves_the_one_it_got(axis):
    eyes = {"rgb": {"sensor": "splat_rgb", "width": 40, "height": 24, "camera": "ego"}}
    setup = trial_setup(fake_card(eyes))
    value = axis.low + 0.35 * (axis.high - axis.low)
    before = repr(setup)
    assert repr(axis.change(setup, axis.nearest_step(value))) != before
    assert repr(setup) == before
