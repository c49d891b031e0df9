from types import SimpleNamespace

import numpy as np
import pytest

from nw_base.memory import pack
from nw_sim.sensors import build_sensors
from nw_sim.sensors.build import Sampled


class Steps:
    """Measures the number of the step, and counts how often it is asked."""

    shape = (1,)
    dtype = np.dtype(np.float32)
    unit = "step"
    is_image = False
    coverage = None

    def __init__(self):
        self.count = 0

    def reset(self):
        self.count = 0

    def measure(self, moment):
        self.count += 1
        return np.array([moment.step], dtype=np.float32)

    def state(self):
        return {"count": np.array(self.count)}

    def restore(self, state):
        self.count = int(state["count"])


def seen(sensor, steps):
    return [int(sensor.read(SimpleNamespace(step=step))[0]) for step in steps]


def test_a_slow_sensor_holds_its_sample_and_measures_no_more_often():
    steps = Steps()
    sensor = Sampled("s", steps, rate=10)
    assert seen(sensor, range(12)) == [0, 0, 0, 0, 0, 5, 5, 5, 5, 5, 10, 10]
    assert steps.count == 3


@pytest.mark.parametrize(
    ("latency", "expected"),
    [
        (0.04, [0, 0, 0, 0, 0, 0, 0, 5, 5, 5]),
        (0.10, [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_latency_delays_samples_and_the_first_one_stands_in(latency, expected):
    assert seen(Sampled("s", Steps(), rate=10, latency=latency), range(10)) == expected


def test_latency_longer_than_a_period_keeps_several_samples_on_their_way():
    sensor = Sampled("s", Steps(), rate=50, latency=0.06)
    assert seen(sensor, range(6)) == [0, 0, 0, 0, 1, 2]


def test_fresh_says_when_the_policy_sees_something_new():
    sensor = Sampled("s", Steps(), rate=10, latency=0.02)
    fresh = []
    for step in range(8):
        sensor.read(SimpleNamespace(step=step))
        fresh.append(sensor.fresh)
    assert fresh == [True, False, False, False, False, False, True, False]


def test_a_sensor_goes_back_to_its_state():
    sensor = Sampled("s", Steps(), rate=10, latency=0.14)
    seen(sensor, range(9))
    state = sensor.state()
    expected = seen(sensor, range(9, 30))
    other = Sampled("s", Steps(), rate=10, latency=0.14)
    other.restore(state)
    assert seen(other, range(9, 30)) == expected


def test_states_of_equal_sensors_are_equal_bytes():
    first, second = (Sampled("s", Steps(), rate=10) for _ in range(2))
    seen(first, range(7))
    seen(second, range(7))
    assert first.state() == second.state()


@pytest.mark.parametrize("kind", ["<f4", ">f4", "|u1"])
def test_a_sample_alone_is_saved_as_arrays_are(kind):
    class Plain(Steps):
        dtype = np.dtype(kind)

        def measure(self, moment):
            return np.array([moment.step], kind)

        def state(self):
            return {}

    sensor = Sampled("s", Plain())
    seen(sensor, range(4))
    saved = {"steps": np.array([3]), "samples": np.array([[3]], kind)}
    assert sensor.state() == pack(saved)


def test_only_what_the_card_names_is_made(world, card_of):
    def no_renderer(scene):
        raise AssertionError(f"a renderer was made for {scene.name}")

    sensors = build_sensors(card_of({"dots": {"sensor": "scandots"}}), world, renderer=no_renderer)
    assert list(sensors) == ["dots"]


def test_a_history_goes_back_with_its_sensor(world, card_of, moment_of):
    observation = {"sensor": "proprio", "terms": ["joint_pos"], "history": 4}
    first, second = (build_sensors(card_of({"o": observation}), world)["o"] for _ in range(2))
    pose = np.array(world.robot.default_pose)
    for step in range(6):
        world.step(pose + 0.02 * step)
        first.read(moment_of(world, step=step))
    second.restore(first.state())
    world.step(pose)
    expected = first.read(moment_of(world, step=6))
    assert second.read(moment_of(world, step=6)).tobytes() == expected.tobytes()
