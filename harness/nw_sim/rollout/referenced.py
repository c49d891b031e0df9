"""The motion of a card or of a suite, put on the robot: joints in its order, at the control rate.

Between the frames of a file positions and angles are interpolated, and orientations along the
shortest arc, as `scripts/csv_to_npz.py` of HybridRobotics/whole_body_tracking does it. All poses of
bodies follow from the root's and the joints by the robot's own kinematics; those in the file tell
whether joints and robot are the right ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nw_base.errors import PolicyError, StoreError
from nw_base.memory import pack, unpack
from nw_base.plural import plural
from nw_policies.bundle import Weights, read_file
from nw_policies.cards import JointControl
from nw_policies.cards.joints import level_by_level, short_name
from nw_policies.motions.motion import FRAMES
from nw_policies.motions.reading import read_motion
from nw_sim.tasks.reference import Reference, conjugate, product, turned

if TYPE_CHECKING:
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_policies.motions.motion import Array, MotionFile
    from nw_sim.physics import World
    from nw_sim.tasks.track import Motion

_LOOKED_AT = 5
"""Frames at which orders of joints are compared."""
_OTHER_ROBOT = 0.05
"""m by which bodies of the file may lie beside the robot's on average."""
_CLEARLY = 0.005
"""m by which another order must be better than the robot's own."""


def reference_of(
    bundle: Bundle, world: World, card: Card, named: Motion | None = None
) -> Reference | None:
    """Return the motion of a suite or of a card on the robot; None where neither names one.

    Args:
        bundle: with the motion of its card.
        world: of the robot, at its control rate.
        card: of the policy, as the trial has it; its anchor and bodies count for any motion.
        named: the suite's, which counts before the card's.

    Raises:
        PolicyError: the file is no motion, or one of another robot; says what is wrong with it.
    """
    if card.reference is None or (named is None and bundle.motion is None):
        return None
    file = bundle.motion
    if named is not None:
        file = Weights(Path(named.file), named.sha256 or "")
        said = card.reference.model_copy(update={"rate": named.rate, "joints": named.joints})
        card = card.model_copy(update={"reference": said})
    assert file is not None
    control, robot = card.control, world.robot
    wanted = (
        *(file.sha256, card.reference, repr(control.joints), repr(control.default_pose)),
        *(robot.mjcf, robot.bodies, robot.joints, world.control_rate),
    )
    if (known := _known.get(wanted)) is None:
        where = str(file.path)
        data = read_file(file, bundle.folder, "motion")
        place = "the card's `reference`" if named is None else "the suite's `task.motion`"
        known = _Fitting(read_motion(data, where), world, card, where, place).reference()
        while len(_known) >= _KEPT:
            del _known[next(iter(_known))]
        _known[wanted] = known
    return known


_KEPT = 4
_known: dict[tuple[object, ...], Reference] = {}
"""Motions on robots, by all that they depend on: all trials of a process track the same."""


class _Fitting:
    """Puts one motion on one robot."""

    def __init__(
        self, motion: MotionFile, world: World, card: Card, where: str, named: str
    ) -> None:
        assert card.reference is not None
        self._named = named
        self._motion, self._world, self._card, self._where = motion, world, card, where
        self._said = card.reference
        self._robot = world.robot
        control = JointControl.from_card(card, self._robot)
        self._pose = np.empty(len(self._robot.joints))
        self._pose[control.order] = control.default_pose

    def reference(self) -> Reference:
        """Return the motion.

        Raises:
            PolicyError: it does not fit.
        """
        rate = self._motion.rate or self._said.rate
        if rate is None and self._motion.joint_velocities is not None:
            rate = self._world.control_rate  # A checkpoint has a row for each of its actions.
        if rate is None:
            raise PolicyError(
                f"{self._where}: the file does not say how many frames it has a second",
                fix=f"add `rate` to {self._named}; LAFAN1 sets have 30",
            )
        angles, rates = self._joints()
        root = self._root(angles)
        step = 1.0 / self._world.control_rate
        if (len(angles) - 1) / (rate * step) > FRAMES:
            raise PolicyError(
                f"{self._where}: {len(angles)} frames at {rate:g} a second are more than {FRAMES} "
                "control steps",
                fix="cut the motion into pieces, or correct its frames a second",
            )
        if abs(rate * step - 1.0) > 1e-9:
            angles, root = _resampled(angles, root, rate, step)
            rates = None
        if len(angles) < 2:
            raise PolicyError(
                f"{self._where}: the motion is shorter than two control steps",
                fix=f"check `rate` of {self._named}",
            )
        if rates is None:
            rates = np.gradient(angles, step, axis=0)
        return _on_robot(angles, rates, root, self._world, self._card)

    def _joints(self) -> tuple[Array, Array | None]:
        """Return angles (T, J), rad, and rates, rad/s, of the robot's joints in its order."""
        motion, own = self._motion, [*map(short_name, self._robot.joints)]
        count = motion.joint_positions.shape[1]
        names = [*map(short_name, self._said.joints or motion.joints)] or self._order(count)
        if len(names) != count:
            raise PolicyError(
                f"{self._where}: it has {plural(count, 'joint')}, and `joints` of "
                f"{self._named} names {len(names)}",
                fix="name one for each column",
            )
        absent = [name for name in names if name not in own]
        if absent:
            raise PolicyError(
                f"{self._where}: the robot {self._robot.name} has no joint {absent[0]!r}",
                fix=f"give this robot's motion, or name its joints with `joints` of {self._named}",
            )
        angles = np.tile(self._pose, (len(motion.joint_positions), 1))
        places = [own.index(name) for name in names]
        angles[:, places] = motion.joint_positions
        rates = None
        if motion.joint_velocities is not None:
            rates = np.zeros_like(angles)
            rates[:, places] = motion.joint_velocities
        if len(motion.positions[0]) > 1:
            self._check(angles)
        return angles, rates

    def _order(self, count: int) -> list[str]:
        """Return the joints of a file that names none: in the order that its bodies fit best."""
        own = [*map(short_name, self._robot.joints)]
        if count != len(own):
            raise PolicyError(
                f"{self._where}: the motion has {plural(count, 'joint')} without names, the robot "
                f"{self._robot.name} has {len(own)}",
                fix=f"name them in their order with `joints` of {self._named}",
            )
        if self._motion.positions.shape[1] == 1:
            return own
        orders = [own, [*map(short_name, self._card.control.joints or ())]]
        orders.append([*level_by_level(self._robot)])
        misses = {tuple(order): self._miss(order) for order in orders if order}
        best = min(misses, key=misses.__getitem__)
        return own if misses[tuple(own)] <= misses[best] + _CLEARLY else [*best]

    def _miss(self, names: Sequence[str]) -> float:
        """Return how far bodies are from those of the file, m, if its joints are in an order."""
        own = [*map(short_name, self._robot.joints)]
        angles = np.tile(self._pose, (len(self._motion.joint_positions), 1))
        angles[:, [own.index(name) for name in names]] = self._motion.joint_positions
        return self._distance(angles)

    def _distance(self, angles: Array) -> float:
        motion = self._motion
        frames = np.linspace(0, len(angles) - 1, _LOOKED_AT).astype(np.intp)
        root = np.concatenate([motion.positions[frames, 0], motion.quats[frames, 0]], axis=1)
        ours, _ = self._world.kinematics(root, angles[frames], self._robot.bodies)
        theirs = motion.positions[frames]
        apart = np.sqrt(((ours[:, :, np.newaxis] - theirs[:, np.newaxis]) ** 2).sum(axis=-1))
        # Either may have bodies that the other has not, such as those of sensors.
        nearest = [apart.min(axis=axis).sum() / apart.shape[3 - axis] for axis in (1, 2)]
        return float(min(nearest)) / len(frames)

    def _check(self, angles: Array) -> None:
        if (apart := self._distance(angles)) > _OTHER_ROBOT:
            raise PolicyError(
                f"{self._where}: bodies of the motion lie {apart:.2f} m beside those of the robot "
                f"{self._robot.name} on average, with joints in any order that is known here",
                fix=f"give this robot's motion, or name its joints with `joints` of {self._named}",
            )

    def _root(self, angles: Array) -> Array:
        """Return the poses of the robot's root, (T, 7)."""
        positions, quats = self._motion.positions[:, 0], self._motion.quats[:, 0]
        if self._motion.is_of_anchor:
            anchor = self._said.anchor or self._robot.root
            still = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(angles), 1))
            off, turn = self._world.kinematics(still, angles, (anchor,))
            quats = product(quats, conjugate(turn[:, 0]))
            positions = positions - turned(quats, off[:, 0])
        return np.concatenate([positions, quats], axis=1)


def _on_robot(angles: Array, rates: Array, root: Array, world: World, card: Card) -> Reference:
    """Return a motion whose frames are control steps, with the poses of the robot's bodies."""
    assert card.reference is not None
    anchor = card.reference.anchor or world.robot.root
    names, parents = card.reference.bodies or world.robot.bodies, world.hangs_on()
    positions, quats = world.kinematics(root, angles, (*names, anchor))
    return Reference(
        joint_positions=angles,
        joint_velocities=rates,
        root=np.concatenate([root, _velocities(root, world.control_period)], axis=1),
        bodies=tuple(names),
        positions=positions[:, :-1],
        quats=quats[:, :-1],
        anchor=anchor,
        anchor_positions=positions[:, -1],
        anchor_quats=quats[:, -1],
        ends=tuple(k for k, name in enumerate(names) if _is_end(name, names, parents)),
    )


def packed_motion(motion: Reference) -> bytes:
    """Return a motion as a log keeps it, for `unpacked_motion`: joints, rates, and the root."""
    return pack(
        {
            "angles": motion.joint_positions,
            "rates": motion.joint_velocities,
            "root": np.ascontiguousarray(motion.root[:, :7]),
        }
    )


def unpacked_motion(data: bytes, world: World, card: Card, where: str) -> Reference:
    """Return the motion that a log keeps, on its robot.

    Raises:
        StoreError: the log has none, or one of another robot.
    """
    try:
        arrays = unpack(data)
        parts = [arrays[name].astype(np.float64) for name in ("angles", "rates", "root")]
        joints = len(world.robot.joints)
        shapes = [(len(parts[0]), size) for size in (joints, joints, 7)]
        if [part.shape for part in parts] != shapes or len(parts[0]) < 2:
            raise ValueError(f"arrays of {[part.shape for part in parts]}")  # noqa: TRY301
    except (KeyError, ValueError) as error:
        raise StoreError(
            f"{where} holds no motion that can be read: {error}", fix="run the trial again"
        ) from None
    return _on_robot(parts[0], parts[1], parts[2], world, card)


def _is_end(name: str, names: Sequence[str], parents: dict[str, str]) -> bool:
    """Return whether no body of `names` hangs on one of them."""
    for other in names:
        above = parents.get(other)
        while above is not None:
            if above == name:
                return False
            above = parents.get(above)
    return True


def _resampled(angles: Array, root: Array, rate: float, step: float) -> tuple[Array, Array]:
    """Return joints and root at another rate: a frame each `step` s, to before the last one."""
    times = np.arange(0.0, (len(angles) - 1) / rate, step) * rate
    low = np.floor(times).astype(np.intp)
    high = np.minimum(low + 1, len(angles) - 1)
    share = (times - low)[:, np.newaxis]
    between = angles[low] * (1.0 - share) + angles[high] * share
    places = root[low, :3] * (1.0 - share) + root[high, :3] * share
    turns = [
        _slerp(one, other, part)
        for one, other, part in zip(
            root[low, 3:].tolist(), root[high, 3:].tolist(), share[:, 0].tolist(), strict=True
        )
    ]
    return between, np.concatenate([places, np.array(turns)], axis=1)


def _slerp(one: Sequence[float], other: Sequence[float], share: float) -> list[float]:
    """Return the quaternion at a share of the shortest arc; in Python, the same bits anywhere."""
    cosine = sum(a * b for a, b in zip(one, other, strict=True))
    other = [-b for b in other] if cosine < 0.0 else other
    arc = math.acos(min(abs(cosine), 1.0))
    first, second = 1.0 - share, share
    if arc > 1e-6:
        first, second = (math.sin(part * arc) / math.sin(arc) for part in (first, second))
    mixed = [first * a + second * b for a, b in zip(one, other, strict=True)]
    norm = math.sqrt(sum(a * a for a in mixed))
    return [a / norm for a in mixed]


def _velocities(root: Array, step: float) -> Array:
    """Return linear, m/s, and angular velocity, rad/s, of a root, (T, 6), from its poses (T, 7)."""
    linear = np.gradient(root[:, :3], step, axis=0)
    between = product(root[2:, 3:], conjugate(root[:-2, 3:]))
    rates: list[list[float]] = []
    for w, x, y, z in between.tolist():
        sine = math.sqrt(x * x + y * y + z * z)
        turn = 2.0 * math.atan2(sine, abs(w)) * (1.0 if w >= 0.0 else -1.0)
        factor = turn / sine if sine > 1e-12 else 2.0
        rates.append([part * factor / (2.0 * step) for part in (x, y, z)])
    rates = [rates[0], *rates, rates[-1]] if rates else [[0.0] * 3] * len(root)
    return np.concatenate([linear, np.array(rates)], axis=1)
