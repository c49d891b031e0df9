"""Every message of a log, against those that were made one by one."""

from hashlib import sha256
from operator import itemgetter

import numpy as np
import pytest
from mcap.reader import make_reader

from nw_scenes.mesh import box_mesh
from nw_scenes.robots import get_robot
from nw_sim.rollout.mcap.images import SeenRow, SeenRows
from nw_sim.rollout.mcap.messages import Saved
from nw_sim.rollout.mcap.steps import Call, StepNote
from nw_sim.rollout.mcap.trial_log import TrialLog

STEPS = 400
# Recorded from the code of before, which made every message by itself. A message that changes on
# purpose changes this, and the CHANGELOG says so.
COUNT = 3128
BEFORE = "f2f46d2652879ab74d66b72298b50f192bea9cd2a80eaad5ae25b3cf480035e4"
SEEN = {
    "body": SeenRow("/observation/body", (15,), (("gravity", 3), ("joint_pos", 12))),
    "map": SeenRow("/observation/map", (4, 5), (("map", 20),)),
}


def numbers(step, *shape):
    """Return numbers that no library's version changes, none of them a round one."""
    count = int(np.prod(shape))
    return ((np.arange(count) * 37 + step * 101) % 1009 / 7.0 - 72.0).reshape(shape)


def turned(step, count):
    """Return unit quaternions of whole fifths, (count, 4)."""
    fifths = np.array([[5, 0, 0, 0], [3, 4, 0, 0], [3, 0, -4, 0], [4, 0, 0, 3]]) / 5.0
    return fifths[(np.arange(count) + step) % 4]


def write(path, record):
    """Write a log of all kinds of messages but pictures."""
    robot = get_robot("go1")
    log, seen = TrialLog(path, record=record), SeenRows(SEEN, is_all=True)
    trail = np.array([[1.0, 0.25, 0.0], [2.5, -0.5, 0.1], [4.0, 0.0, 0.0]])
    log.start(
        robot=robot,
        mesh=box_mesh((1.0, 0.0, 0.5), (0.5, 0.25, 0.5), (1.0, 0.0, 0.0, 0.0), "obstacle"),
        start=(0.1, -0.2, 0.0),
        trail=trail,
        bodies=tuple(range(1, 1 + len(robot.bodies))),
        in_model=len(robot.bodies) + 2,
        cameras={"ego": np.array([0.3, 0.0, 0.1, 0.6, 0.8, 0.0, 0.0])},
        seen=seen,
        command=lambda error: (0.5, error / 4.0, 2.0 * error),
        metadata={"nw.trial": {"a": "b"}},
        attachments=(("suite.yaml", "nw-eval: 1\n"),),
    )
    for step in range(STEPS):
        one_step(log, seen, step, len(robot.bodies) + 2)
    last = b"".join(part.tobytes() for part in body(STEPS, len(robot.bodies) + 2))
    log.step(StepNote(STEPS / 50, last, path="shown"))
    log.event(STEPS / 50, "end", "completed", step=STEPS)
    log.finish(keep_images=True, verdict={"status": "ok"})
    assert not log.error


def body(step, bodies):
    """Return positions, quaternions, angles, velocities, the trunk's, and torques."""
    joints = numbers(step, 12), numbers(step + 1, 12)
    poses = numbers(step, bodies, 3), turned(step, bodies)
    return [*poses, *joints, numbers(step, 6), numbers(step + 2, 12)]


def one_step(log, seen, step, bodies):
    time = step / 50
    if step % 5 == 0:
        parts = {"trail": b"x" * (step % 9), "delay": b""}
        log.state(time, Saved(step, world=bytes(900), policy=b"p", parts=parts))
    motion = [*body(step, bodies), numbers(step, 36)]
    observation = {"body": numbers(step, 15).astype(np.float32), "map": numbers(step, 4, 5)}
    digest, rows = seen.note(observation if step else {})  # The first step is blind.
    data = b"".join((*(part.tobytes() for part in motion), *rows))
    call = Call(
        step=step,
        state_digest=b"" if step % 5 else bytes([step % 251] * 32),
        heading_error=float(numbers(step, 1)[0]) if step else None,
        digest=bytes([step % 256] * 32) if step % 3 else digest,
        new=(True, step % 2 == 0),  # a map at 25 Hz
    )
    path = "none" if step % 5 else "point" if step % 25 else "shown"
    log.step(StepNote(time, data, call, path))
    if step % 150 == 149:
        log.waypoints(time, reached=step // 149)
        log.event(time, "waypoint", "a waypoint", step=step, waypoint=step // 150, value=0.5)


@pytest.mark.parametrize("record", ["all", "failures", "none"])
def test_the_messages_of_every_topic_are_those_of_before(tmp_path, record):
    path = tmp_path / "trial.mcap"
    write(path, record)
    found, digest = [], sha256()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            about = (channel.topic, schema.name, message.log_time, message.publish_time)
            found.append((*about, message.data))
    for *about, data in sorted(found, key=itemgetter(0)):  # each topic's in their order
        digest.update(repr((*about, len(data))).encode() + data)
    assert len(found) == COUNT
    assert digest.hexdigest() == BEFORE
