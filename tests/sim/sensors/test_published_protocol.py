"""neverwhere-2026 against its written specification: the figures and quirks that sensors see."""

from collections import deque

import numpy as np
import pytest

from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_policies import ActionDelay
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.heights import PIXELS_PER_METRE
from nw_sim.sensors.proprio import spoilt_frames

NOW = {"sensor": "proprio", "layout": "parkour53"}
PAST = NOW | {"history": {"steps": 10, "current": False, "zero": ["6:8"]}}


def walk(place, card_of, moment_of, observations, steps, protocol=NEVERWHERE_2026):
    """Yield what observations read before the first control step and after each."""
    robot = get_robot("go1")
    with World(robot, place(), protocol=protocol) as world:
        sensors = build_sensors(card_of(observations), world)
        for sensor in sensors.values():
            sensor.reset(0)
        for step in range(steps + 1):
            moment = moment_of(world, step=step)
            yield {name: sensor.read(moment) for name, sensor in sensors.items()}
            world.step(np.array(robot.default_pose) + 0.2 * np.sin(0.3 * step + np.arange(12)))


def test_pixels_of_the_height_image_are_the_published_size():
    # 480 / (2 * 25 * tan 3 deg).
    assert pytest.approx(183.1789, abs=5e-5) == PIXELS_PER_METRE


@pytest.mark.parametrize(
    ("robot", "mass", "height_camera"),
    [
        ("go1", 12.986, (-0.02443, -0.00170, 25.03206)),
        ("go2", 13.086, (-0.00341, -0.00162, 25.03764)),
    ],
)
def test_masses_and_height_cameras_are_the_published_ones(place, robot, mass, height_camera):
    spec = get_robot(robot)
    with World(spec, place(), protocol=NEVERWHERE_2026) as world:
        assert world._model.body_mass.sum() == pytest.approx(mass, abs=5e-4)
    offset = np.array(spec.height_camera_offset)
    np.testing.assert_allclose(offset, height_camera, atol=5e-6)


@pytest.mark.parametrize(
    ("robot", "position", "pitch"),
    [("go1", (0.27, 0, 0.015), 0.0), ("go2", (0.285, 0, 0.175), 18.4)],
)
def test_the_camera_is_mounted_as_published(robot, position, pitch):
    mount = get_robot(robot).cameras["ego"]
    np.testing.assert_allclose(mount.position, position)
    ahead = np.array(mount.R_trunk_camera)[:, 2]
    assert np.rad2deg(np.arctan2(-ahead[2], ahead[0])) == pytest.approx(pitch, abs=0.05)
    assert 0.5 * 720 / np.tan(0.5 * mount.fovy) == pytest.approx(360.0)


def test_the_first_observation_repeats_numbers_where_it_means_frames(place, card_of, moment_of):
    clean = list(walk(place, card_of, moment_of, {"now": NOW}, 2, protocol=STRICT))
    both = {"now": NOW, "past": PAST}
    seen = list(walk(place, card_of, moment_of, both, 2))
    for step in (0, 1):
        flat = np.concatenate([seen[step]["now"], seen[step]["past"]])
        # Specification: flat[i] = o[floor(i / 11)], i = 0..582. Between the protocols physics
        # differs by the drag of the free joint, which the first 40 ms do not show.
        frame = flat[::11]
        assert flat.tolist() == [frame[i // 11] for i in range(583)]
        np.testing.assert_allclose(frame, clean[step]["now"], atol=2e-2)
        # So the policy first sees ang_vel x, y, z and roll 11 times each, and pitch 9 times.
        roll_pitch = clean[step]["now"][3:5]
        np.testing.assert_allclose(seen[step]["now"][33:44], roll_pitch[0], atol=1e-3)
        np.testing.assert_allclose(seen[step]["now"][44:], roll_pitch[1], atol=1e-3)


def test_the_history_begins_with_the_first_frame_ten_times_without_heading(
    place, card_of, moment_of
):
    both = {"now": NOW, "past": PAST}
    seen = list(walk(place, card_of, moment_of, both, 5))
    # What the buffer holds after the first step is the frame of that step, ten times, unspoilt:
    # of the spoilt observation, every eleventh number.
    first = np.concatenate([seen[1]["now"], seen[1]["past"]])[::11].copy()
    first[6:8] = 0.0
    np.testing.assert_array_equal(seen[2]["past"].reshape(10, 53), np.tile(first, (10, 1)))
    second = seen[2]["now"].copy()
    assert second[6] != 0.0
    second[6:8] = 0.0
    np.testing.assert_array_equal(seen[3]["past"].reshape(10, 53)[-1], second)
    np.testing.assert_array_equal(seen[3]["past"].reshape(10, 53)[:-1], np.tile(first, (9, 1)))


def test_the_strict_protocol_spoils_nothing(place, card_of, moment_of):
    seen = next(walk(place, card_of, moment_of, {"now": NOW, "past": PAST}, 0, protocol=STRICT))
    frame = seen["now"].copy()
    frame[6:8] = 0.0
    np.testing.assert_array_equal(seen["past"].reshape(10, 53), np.tile(frame, (10, 1)))


def test_other_layouts_are_not_spoilt(place, card_of, moment_of):
    own = {"now": {"sensor": "proprio", "terms": ["joint_pos", "joint_vel"]}}
    published, strict = (
        next(walk(place, card_of, moment_of, own, 0, protocol=protocol))["now"]
        for protocol in (NEVERWHERE_2026, STRICT)
    )
    np.testing.assert_array_equal(published, strict)


def test_shorter_and_partial_histories_are_cut_from_the_spoilt_frames(place, card_of, moment_of):
    part = NOW | {
        "select": ["0:5", "13:53"],
        "history": {"steps": 3, "order": "newest_first", "current": False},
    }
    seen = next(walk(place, card_of, moment_of, {"now": NOW, "past": PAST, "part": part}, 0))
    frames = seen["past"].reshape(10, 53)[:-4:-1]
    expected = np.concatenate([frames[:, 0:5], frames[:, 13:53]], axis=1)
    np.testing.assert_array_equal(seen["part"], expected.ravel())


def test_spoilt_frames_are_the_specification_itself():
    frame = np.arange(53, dtype=np.float32)
    assert spoilt_frames(frame).ravel().tolist() == [i // 11 for i in range(583)]


def test_a_stack_begins_with_the_first_step_not_before_it(place, card_of, moment_of):
    stacked = {"way": {"sensor": "direction", "wrap": [{"wrapper": "stack", "steps": 7}]}}
    seen = list(walk(place, card_of, moment_of, stacked, 3))
    assert len(np.unique(seen[1]["way"])) == 1
    assert seen[1]["way"][0, 0] != seen[0]["way"][0, 0]
    strict = list(walk(place, card_of, moment_of, stacked, 1, protocol=STRICT))
    assert len(np.unique(strict[1]["way"])) == 2


def test_actions_wait_as_in_the_published_queue():
    # Published loop: a queue of five zero actions; each step applies the second newest, and only
    # then the policy is asked and its answer queued. Ours asks first, but not before step 0.
    answers = np.random.default_rng(0).normal(size=(20, 12))
    queue, published = deque([np.zeros(12)] * 5, maxlen=5), []
    for step in range(20):
        published.append(queue[-2])
        queue.append(answers[step])
    delay = ActionDelay(1)
    ours = [delay.push(np.zeros(12))] + [delay.push(answers[step - 1]) for step in range(1, 20)]
    np.testing.assert_array_equal(ours, published)
    # The action computed after step k is applied in step k + 2; steps 0 and 1 apply zeros.
    np.testing.assert_array_equal(published[2:], answers[:18])
    assert not np.any(published[:2])
