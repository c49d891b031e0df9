"""What one source of a robot's log says of another: readings that contradict each other.

A reading that cannot be right, or was not measured, is dropped with the reason. Where two sources
disagree and either may be right, a note says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nw_gate.scores.score import Array
from nw_scenes.robots import RobotSpec

_WINDOW = 0.2  # s over which changes are compared with rates
_FASTEST = 10.0  # m/s
_LYING = 1.0  # rad of tilt
_APART = 0.1  # rad between two attitudes
_NEAR_ZERO = 1e-9
_STILL = 1e-5  # of a unit vector: rounding, not the attitude of a trunk
_TRUNK = re.compile("base|body|pelvis|torso|trunk", re.IGNORECASE)


@dataclass
class Readings:
    """The readings of a log while they are checked."""

    robot: RobotSpec
    topics: Mapping[str, str]  # by source
    frames: Mapping[str, set[tuple[str, str]]]  # of poses: that of the numbers, and of whom
    tracks: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    """Ascending times, (N,) s, and values, (N, ...), by reading; `imu_...` is beside a pose."""
    empty: dict[str, str] = field(default_factory=dict)  # why other readings are not there
    notes: list[str] = field(default_factory=list)
    fell: float | None = None  # s

    def drop(self, reading: str, reason: str) -> None:
        """Take a reading out."""
        if self.tracks.pop(reading, None) is not None:
            self.empty[reading] = reason

    def both(self, one: str, other: str) -> tuple[Array, Array, Array] | None:
        """Return the times that two readings share, and both; None for under five of them."""
        if one not in self.tracks or other not in self.tracks:
            return None
        (times, values), (others, more) = self.tracks[one], self.tracks[other]
        shared, first, second = np.intersect1d(times, others, return_indices=True)
        return (shared, values[first], more[second]) if len(shared) >= 5 else None


class _Gap(NamedTuple):
    """Root mean squares over windows: of a change, of what a rate says it is, and between them."""

    changed: float
    said: float
    apart: float

    def wide(self, floor: float) -> bool:
        return self.apart > max(floor, 0.5 * max(self.changed, self.said))

    def note(self, floor: float, said: str, unit: str) -> list[str]:
        """Say that two sources differ, where both may be right: by a fifth and by `floor`."""
        if self.apart <= max(floor, 0.2 * max(self.changed, self.said)):
            return []
        numbers = (
            f"{self.said:.3g} {unit}, its positions {self.changed:.3g}, {self.apart:.3g} apart"
        )
        return [f"{said} say {numbers}: which is right is not known"]


def _gap(times: Array, values: Array, rates: Array) -> _Gap | None:
    """Compare changes of values, by time, with rates, (N, K) each; None for a log too short."""
    steps = np.diff(times)[:, np.newaxis]
    sums = np.vstack(
        [np.zeros_like(rates[:1]), np.cumsum(0.5 * steps * (rates[1:] + rates[:-1]), 0)]
    )
    last = np.searchsorted(times, times + _WINDOW)
    first = np.flatnonzero(last < len(times))
    last = last[first]
    seconds = (times[last] - times[first])[:, np.newaxis]
    whole = (seconds < 2.0 * _WINDOW + 0.1).ravel()
    if np.count_nonzero(whole) < 3:
        return None
    changed = ((values[last] - values[first]) / seconds)[whole]
    said = ((sums[last] - sums[first]) / seconds)[whole]
    sizes = (np.linalg.norm(each, axis=1) for each in (changed, said, changed - said))
    return _Gap(*(float(np.sqrt(np.mean(size**2))) for size in sizes))


def doubt(readings: Readings) -> None:
    """Drop what contradicts another source, or note it; velocity is then that in the world."""
    _doubt_rates(readings)
    _doubt_torques(readings)
    _doubt_positions(readings)
    for source, frames in readings.frames.items():
        for reading in (
            ("position", "rotation", "world_velocity", "rates") if len(frames) > 1 else ()
        ):
            name = reading if source == "pose" else f"imu_{reading}"
            readings.drop(name, f"frames of {readings.topics[source]} change: {sorted(frames)[:4]}")
    _doubt_twist(readings)
    if pair := readings.both("rotation", "rates"):
        yaw = np.unwrap(np.arctan2(pair[1][:, 3], pair[1][:, 0]))[:, np.newaxis]
        if (gap := _gap(pair[0], yaw, pair[2][:, 2:])) and gap.wide(0.2):
            readings.drop(
                "rates",
                f"yaw rates of {readings.topics['pose']} ({gap.said:.3g} rad/s) contradict its "
                f"attitude ({gap.changed:.3g} rad/s)",
            )
    _doubt_attitude(readings)


def _doubt_rates(readings: Readings) -> None:
    topic = readings.topics.get("joints", "")
    if not (pair := readings.both("joint_positions", "joint_rates")) or not (gap := _gap(*pair)):
        return
    reason = (
        f"velocities of {topic} ({gap.said:.3g} rad/s of all joints) contradict its positions "
        f"({gap.changed:.3g} rad/s)"
    )
    odd = [
        joint
        for joint, *columns in zip(readings.robot.joints, pair[1].T, pair[2].T, strict=True)
        if (one := _gap(pair[0], *(column[:, np.newaxis] for column in columns)))
        and one.changed > _NEAR_ZERO
        and one.wide(0.5)
    ]
    if gap.changed > _NEAR_ZERO and (not gap.said or gap.wide(0.5)):
        readings.drop("joint_rates", reason)
    elif odd:
        readings.drop("joint_rates", f"velocities of {topic} contradict its positions: {odd}")
    elif gap.wide(0.5):  # Positions that never change were not measured.
        readings.notes.append(f"{reason}; power is computed from velocities")
    else:
        readings.notes += gap.note(0.1, f"velocities of {topic}", "rad/s of all joints")


def _doubt_torques(readings: Readings) -> None:
    topic = readings.topics.get("joints", "")
    if "torques" in readings.tracks:
        shares = np.abs(readings.tracks["torques"][1]) / np.array(readings.robot.torque_limits)
        most = shares.max(axis=0).tolist()
        if idle := [
            joint for joint, share in zip(readings.robot.joints, most, strict=True) if not share
        ]:
            whose = f" of {', '.join(idle)}" * (len(idle) < len(most))
            readings.drop(
                "torques", f"{topic} has efforts{whose} of 0 throughout: they are not measured"
            )
        elif (often := float(np.mean(shares.max(axis=1) > 2.0))) > 0.01:
            readings.drop(
                "torques",
                f"efforts of {topic} are up to {shares.max():.3g} times the limits of "
                f"{readings.robot.name}: not N m of its motors",
            )
        elif often:
            readings.notes.append(f"efforts of {topic} peak at {shares.max():.3g} times the limit")
    if pair := readings.both("torques", "joint_rates"):
        power = pair[1] * pair[2]
        gives, takes = (float(np.maximum(each, 0.0).sum(1).mean()) for each in (power, -power))
        if takes > max(2.0 * gives, 5.0):
            readings.notes.append(
                f"motors take in {takes:.3g} W and give {gives:.3g} W: efforts or velocities of "
                f"{topic} may have the wrong sign"
            )


def _outside(readings: Readings, reading: str) -> tuple[str, float]:
    """Return which joint is beyond its range most of the time, if one is, and how far, rad."""
    if reading not in readings.tracks:
        return "", 0.0
    low, high = np.array(readings.robot.joint_ranges).T
    middle = np.median(readings.tracks[reading][1], axis=0)
    beyond = np.maximum(low - middle, middle - high)
    worst = int(beyond.argmax())
    if beyond[worst] <= 0.5:
        return "", 0.0
    return (
        f"{readings.robot.joints[worst]} at {middle[worst]:.3g} rad, outside its range of "
        f"{low[worst]:.3g} to {high[worst]:.3g}: another unit, zero or order of joints"
    ), float(beyond[worst])


def _doubt_positions(readings: Readings) -> None:
    """Drop joints and targets out of range, and jumps of the trunk."""
    torques = readings.tracks.pop("target_torques", None)
    for reading, source, more in (
        ("joint_positions", "joints", ""),
        ("targets", "targets", ", or actions before scale and offset"),
    ):
        reason, far = _outside(readings, reading)
        if reason:
            readings.drop(reading, reason := f"{readings.topics[source]} has {reason}{more}")
            if source == "joints" and far > np.pi:  # In degrees, as its velocities are.
                readings.drop("joint_rates", reason)
        elif source == "targets" and "targets" not in readings.tracks and torques is not None:
            readings.tracks["targets"] = torques
            readings.notes.append(f"targets of {readings.topics['targets']} are torques, N m")
    if "position" in readings.tracks:
        times, places = readings.tracks["position"]
        ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
        if (ways > _FASTEST * np.maximum(np.diff(times), _WINDOW)).any():
            readings.drop(
                "position", f"positions of {readings.topics['pose']} jump by {ways.max():.3g} m"
            )


def _doubt_twist(readings: Readings) -> None:
    """Take the twist to the world, by the frame that the message names and the positions allow."""
    if "world_velocity" not in readings.tracks:
        return
    topic, (frame, child) = readings.topics["pose"], next(iter(readings.frames["pose"]))
    pair = readings.both("world_velocity", "rotation")
    if pair is None:
        readings.drop("world_velocity", f"{topic} has no attitude that its twist is turned by")
        return
    times, twist, rows = pair
    turned = np.einsum("nij,nj->ni", rows.reshape(-1, 3, 3), twist)
    in_world = bool(frame) and child == frame
    if in_world and (spin := readings.both("rates", "rotation")):
        back = np.einsum("nji,nj->ni", spin[2].reshape(-1, 3, 3), spin[1])
        readings.tracks["rates"] = spin[0], back
        readings.notes.append(
            f"the twist of {topic} is in the frame {child!r}, as its messages say"
        )
    gaps: list[_Gap] = []
    for velocity in (turned, twist) if in_world else (twist, turned):  # As it is meant comes last.
        readings.tracks["world_velocity"] = times, velocity
        place = readings.both("position", "world_velocity")
        gaps += [gap] if place is not None and (gap := _gap(*place)) is not None else []
    if not gaps:
        readings.notes.append(
            f"the twist of {topic} was not compared with positions: there are none"
        )
        return
    other, gap = gaps
    turned_frame = other.apart < 0.5 * gap.apart
    if not (gap.wide(0.1) or (turned_frame and gap.apart > max(0.03, 0.1 * gap.changed))):
        readings.notes += gap.note(0.05, f"velocities of the twist of {topic}", "m/s")
        return
    reason = (
        f"the twist of {topic} (in {child or 'no frame'!r}) says {gap.said:.3g} m/s, its positions "
        f"{gap.changed:.3g} m/s, {gap.apart:.3g} m/s apart"
    )
    if turned_frame:
        reason += f"; it would agree in the frame {'of the trunk' if in_world else repr(frame)}"
    readings.drop("world_velocity", reason)
    if not gap.changed:
        readings.drop(
            "position", f"{topic} stays in one place, and its twist says {gap.said:.3g} m/s"
        )
    elif not turned_frame:
        readings.notes.append(f"{reason}: the way is that of the positions")


def _doubt_attitude(readings: Readings) -> None:
    """Drop roll and pitch that were not measured, or that a second source denies."""
    if "imu_rotation" in readings.tracks and (reason := _untrue(readings, "imu", "imu_")):
        readings.drop("imu_rotation", reason)
        readings.notes.append(
            f"the attitude of {readings.topics['imu']} was not compared: {reason}"
        )
    if "rotation" not in readings.tracks:
        return
    times, rows = readings.tracks["rotation"]
    ups = rows[:, 6:]
    frame, child = next(iter(readings.frames["pose"]))
    whose = child or frame * ("acceleration" in readings.tracks)
    if whose and not _TRUNK.search(whose):
        readings.notes.append(
            f"roll and pitch are those of {whose!r} of {readings.topics['pose']}, whose mounting "
            "on the trunk the log does not say"
        )
    reason = _untrue(readings, "pose", "")
    if not reason and "imu_rotation" in readings.tracks:
        reason = _denied(readings, times, ups)
    if reason:
        if "imu_rotation" in readings.tracks:
            imu = readings.topics["imu"]
            reason += f"; {imu} has them: --topic pose={imu}"
        readings.empty["tilt"] = reason
        readings.tracks["rotation"] = times, np.hstack([rows[:, :6], np.full_like(ups, np.nan)])
    elif (lies := ups[:, 2] < np.cos(_LYING)).any():
        readings.fell = float(times[np.argmax(lies)])


def _untrue(readings: Readings, source: str, prefix: str) -> str:
    """Return why an attitude cannot be that of the trunk; nothing where it can."""
    topic, (_, rows) = readings.topics[source], readings.tracks[f"{prefix}rotation"]
    ups = rows[:, 6:]  # of the world, in the frame of the trunk
    begin = np.degrees(np.arccos(np.clip(np.median(ups[: max(1, len(ups) // 10), 2]), -1.0, 1.0)))
    if begin > np.degrees(_LYING):
        return (
            f"{topic} begins {begin:.0f} degrees from upright: a sensor mounted turned, or a frame "
            "whose z is down"
        )
    if len(ups) > 5 and np.ptp(ups, axis=0).max() < _STILL:
        return f"roll and pitch of {topic} never change: they are not measured"
    if (pair := readings.both(f"{prefix}rotation", f"{prefix}acceleration")) is not None:
        force = np.einsum("nij,nj->ni", pair[1].reshape(-1, 3, 3), pair[2]).mean(axis=0)
        off = float(np.degrees(np.arctan2(np.hypot(*force[:2]), force[2])))
        if np.linalg.norm(force) > 5.0 and 20.0 < off < 160.0:
            return f"up is {off:.0f} degrees off by the accelerometer of {topic}"
    return ""


def _denied(readings: Readings, times: Array, ups: Array) -> str:
    """Return how the IMU's attitude contradicts that of the pose; note a constant difference."""
    others, rows = readings.tracks["imu_rotation"]
    near = rows[np.clip(np.searchsorted(others, times), 0, len(others) - 1), 6:]
    angles = np.arccos(np.clip((near * ups).sum(axis=1), -1.0, 1.0))
    pose, imu = readings.topics["pose"], readings.topics["imu"]
    if (apart := float(np.median(angles))) <= _APART:
        return ""
    said = f"roll and pitch of {pose} and {imu} are {np.degrees(apart):.0f} degrees apart"
    ways = [each - each.mean(axis=0) for each in (ups, near, ups - near)]
    sizes = [float(np.sqrt((way**2).sum(axis=1).mean())) for way in ways]
    if sizes[2] > max(_APART, 0.5 * max(sizes[:2])):
        return said
    readings.notes.append(f"{said}, about as much throughout: one may be mounted turned")
    return ""
