"""The shipped policies in a closed loop, without the runner."""

from pathlib import Path

import numpy as np
import pytest

from nw_policies import ActionDelay, load_bundle, open_policy
from nw_policies.cards import JointControl, actuator_values
from nw_scenes.robots import get_robot
from nw_sim.physics import Actuators, World
from nw_sim.sensors import StepContext, build_sensors
from nw_sim.tasks import Course, TaskRules

ASSETS = Path(__file__).parents[4] / "shared" / "assets" / "policies"


def run(bundle, scene, *, duration, y=0.0):
    """Run a trial; return how it ended, the share of waypoints, and where the trunk got to."""
    card, robot = bundle.card, get_robot(bundle.card.robot)
    motors = actuator_values(card, robot)
    with World(robot, scene, actuators=None if motors is None else Actuators(**motors)) as world:
        world.reset(position=(0.0, y, robot.spawn_height), yaw=0.0)
        task = Course.along(scene.trail, (0.0, y), TaskRules(duration=duration))
        sensors, policy = build_sensors(card, world), open_policy(bundle)
        for sensor in sensors.values():
            sensor.reset(0)
        policy.reset(0)
        control, delay = JointControl.from_card(card, robot), ActionDelay(card.control.delay_steps)
        applied = output = np.zeros(12)
        outcome, step = None, 0
        while outcome is None:
            moment = StepContext(
                world=world,
                task=task,
                step=step,
                applied_action=applied,
                last_output=output,
            )
            output = policy.act({name: sensor.read(moment) for name, sensor in sensors.items()})
            applied = delay.push(output)
            world.step(control.targets(applied))
            step += 1
            task.update(world)
            outcome = task.end()
        policy.close()
        return outcome, task.success, world.trunk_position


BARS = [((2.0, 0.0, 0.11), (0.18, 1.0, 0.11)), ((3.8, 0.0, 0.11), (0.18, 1.0, 0.11))]
BARS_TRAIL = [(2.0, 0.0, 0.22), (3.8, 0.0, 0.22), (5.2, 0.0, 0.0)]


def test_go1_parkour_crosses_two_bars_of_22_centimetres(place):
    scene = place(*BARS, trail=BARS_TRAIL)
    ends = [run(load_bundle("go1-parkour"), scene, duration=12.0, y=y) for y in (-0.05, 0.0, 0.05)]
    # The training's own share on such bars is 0.97 to 0.98 (policies/go1-parkour/README.md).
    assert np.mean([fraction for _, fraction, _ in ends]) >= 0.9


def test_doing_nothing_reaches_nothing(place):
    scene = place(*BARS, trail=BARS_TRAIL)
    outcome, fraction, position = run(load_bundle("stand"), scene, duration=2.0)
    assert (outcome, fraction) == ("timeout", 0.0)
    assert abs(position[0]) < 0.1
    assert position[2] > 0.2


@pytest.mark.assets
@pytest.mark.skipif(not ASSETS.is_dir(), reason="the third-party weights are not here")
def test_a_third_party_policy_walks_by_its_card_and_is_stopped_by_a_high_bar(place):
    weights = ASSETS / "playground-go1" / "go1_policy.onnx"
    bundle = load_bundle("examples/playground-go1", checkpoint=weights)
    far = [(30.0, 0.0, 0.0)]
    _, _, position = run(bundle, place(trail=far), duration=8.0)
    assert position[0] > 3.0
    assert abs(position[1]) < 0.5
    bar = ((2.0, 0.0, 0.15), (0.2, 1.5, 0.15))
    outcome, _, position = run(bundle, place(bar, trail=far), duration=8.0)
    assert position[0] < 1.8
    assert outcome != "completed"
