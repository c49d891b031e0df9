"""One trajectory: what the student was given on its way, and what the teacher would have done.

`Watcher` collects it as somebody drives; a `Dataset` holds all of them in memory and draws batches.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import StoreError
from nw_learn.student.card import BODY, DEPTH_STEPS
from nw_policies import open_policy
from nw_sim.rollout.episode import Observer
from nw_sim.sensors import build_sensors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_policies import Bundle, Observation
    from nw_sim.rollout.episode import Decision
    from nw_sim.rollout.library import Library
    from nw_sim.rollout.opening import OpenTrial
    from nw_sim.sensors.sensor import Sensor

# What a damaged file may cause in the library that reads it.
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, MemoryError, BadZipFile)

Bytes = NDArray[np.uint8]
Rows = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """T control steps with F images of each camera, of which one is held for some steps."""

    body: Rows
    """(T, numbers) what the student was told of its body."""
    labels: Rows
    """(T, 12) the teacher's raw actions in the same states."""
    frame_of: NDArray[np.int32]
    """(T,) the newest image of each step; from 0, never falling."""
    rgb: Bytes
    """(F, 3, rows, columns); none of them where the student sees no colours."""
    depth: Bytes
    """(F, 1, rows, columns) shares of the clipping distance in 255 steps; as above."""
    success: float
    """Share of waypoints that whoever drove has reached."""

    @property
    def steps(self) -> int:
        """Control steps."""
        return len(self.body)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(np.asarray(getattr(self, field.name)).nbytes for field in fields(self))

    def write(self, path: Path) -> None:
        """Write it, whole or not at all; a fenced process may.

        Raises:
            StoreError: it cannot be written.
        """
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        part = path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            part.replace(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise StoreError(
                f"cannot write {path}: {error.strerror}", fix="free disk space"
            ) from error


def read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory; a file of another kind runs no code.

    Raises:
        StoreError: it is missing, damaged or something else.
    """
    try:
        with ZipFile(path) as archive:  # Ours are as large as what is in them: no bomb is one.
            if any(member.compress_type != ZIP_STORED for member in archive.infolist()):
                raise ValueError("its arrays are compressed")
        with np.load(path, allow_pickle=False) as file:
            arrays: dict[str, Any] = {each.name: file[each.name] for each in fields(Trajectory)}
        arrays["success"] = float(arrays["success"])
        read = Trajectory(**arrays)
        _check(read)
    except _DAMAGE as error:
        raise StoreError(
            f"{path} is not a trajectory: {error}", fix="remove it; it will be driven again"
        ) from None
    return read


def _check(read: Trajectory) -> None:
    """Refuse arrays that do not belong together.

    Raises:
        ValueError: naming what is wrong.
    """
    kinds = {"body": "f4", "labels": "f4", "frame_of": "i4", "rgb": "u1", "depth": "u1"}
    for name, kind in kinds.items():
        if getattr(read, name).dtype != np.dtype(kind):
            message = f"`{name}` is {getattr(read, name).dtype}"
            raise ValueError(message)
    steps, frames = read.steps, max(len(read.rgb), len(read.depth))
    if not (len(read.labels) == len(read.frame_of) == steps > 0):
        raise ValueError("its rows are of different numbers of steps")
    if int(read.frame_of.min()) < 0 or int(read.frame_of.max()) >= frames:
        raise ValueError("a step has an image that is not there")


class Watcher(Observer):
    """Collects a trajectory of a trial that one of two policies drives.

    The one that does not drive has its own sensors in the same world; if that is the teacher, it is
    asked in every state what it would do.

    Args:
        trial: stands at its first control step.
        library: of this process.
        student: its card.
        teacher: card and checkpoint.
    """

    def __init__(
        self, trial: OpenTrial, library: Library, *, student: Bundle, teacher: Bundle
    ) -> None:
        self._student_drives = trial.bundle.reference == student.reference
        other = teacher if self._student_drives else student
        self._others = _sensors(trial, library, other)
        self._eyes: Mapping[str, Sensor] = (
            trial.episode.sensors if self._student_drives else self._others
        )
        self._teacher = open_policy(teacher) if self._student_drives else None
        if self._teacher is not None:
            self._teacher.reset(_seed(trial, "teacher"))
        self._body: list[NDArray[Any]] = []
        self._labels: list[NDArray[Any]] = []
        self._frame_of: list[int] = []
        self._frames: dict[str, list[NDArray[np.uint8]]] = {"rgb": [], "depth": []}

    def decided(self, decision: Decision) -> None:
        """Take down a state: before anything moves."""
        moment = decision.moment
        assert moment is not None, "trials of this protocol begin with an observation"
        others = {name: sensor.read(moment) for name, sensor in self._others.items()}
        seen = decision.observation if self._student_drives else others
        label = decision.action if self._teacher is None else self._teacher.act(others)
        self._body.append(np.concatenate([seen[name] for name in BODY], dtype=np.float32))
        self._labels.append(label.astype(np.float32))
        self._look(seen)

    def trajectory(self, success: float) -> Trajectory:
        """Return what was collected; at least one step."""
        return Trajectory(
            body=np.stack(self._body),
            labels=np.stack(self._labels),
            frame_of=np.array(self._frame_of, np.int32),
            rgb=_stacked(self._frames["rgb"]),
            depth=_stacked(self._frames["depth"]),
            success=success,
        )

    def close(self) -> None:
        """Free the teacher."""
        if self._teacher is not None:
            self._teacher.close()

    def _look(self, seen: Observation) -> None:
        """Keep the newest image of each camera, if it is new: those before it have been kept."""
        for name, frames in self._frames.items():
            if name in seen and self._eyes[name].fresh:
                frames.append(newest(name, seen[name]))
        count = max(len(frames) for frames in self._frames.values())
        self._frame_of.append(count - 1)


def newest(name: str, image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the newest image of a stack as bytes, (channels, rows, columns)."""
    if name == "rgb":
        return image[-3:].copy()
    return np.rint(image[-1:] * DEPTH_STEPS).astype(np.uint8)


def _stacked(frames: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    return np.stack(frames) if frames else np.empty((0, 0, 0, 0), np.uint8)


def _sensors(trial: OpenTrial, library: Library, bundle: Bundle) -> dict[str, Sensor]:
    """Return the sensors of a card in the world of a trial that another one drives."""
    job = trial.job
    sensors = build_sensors(
        bundle.card,
        trial.episode.world,
        rays=lambda: library.rays(job.scene, job.collision),
        renderer=lambda _scene: trial.renderer(),
    )
    for name, sensor in sensors.items():
        sensor.reset(_seed(trial, f"{bundle.name} sensor {name}"))
    return sensors


def _seed(trial: OpenTrial, stream: str) -> int:
    return int(trial.job.trial.seed_sequence(stream).generate_state(1, np.uint32)[0])


@dataclass(frozen=True, kw_only=True)
class Minibatch:
    """M images with the N control steps that each of them is the newest image of."""

    images: dict[str, NDArray[np.uint8]]
    """By camera (M, channels, rows, columns), older images of a stack first."""
    image_of: NDArray[np.int64]
    """(N,) which image each step has."""
    body: NDArray[np.float32]
    """(N, numbers)."""
    labels: NDArray[np.float32]
    """(N, chunk, 12) what the teacher would have done in this state and the ones after it."""
    is_there: NDArray[np.bool_]
    """(N, chunk) false beyond the trajectory's end."""


class Dataset:
    """Trajectories, and where in them each image is.

    Args:
        cameras: what the student sees, in the network's order.
        frames: images of a stack.
        chunk: actions of a prediction.
    """

    def __init__(self, *, cameras: tuple[str, ...], frames: int, chunk: int) -> None:
        self.trajectories: list[Trajectory] = []
        self._cameras = cameras
        self._frames = frames
        self._chunk = chunk
        self._firsts = np.zeros(1, np.int64)  # Number of the first image of each, and of the next.

    @property
    def images(self) -> int:
        """How many images there are."""
        return int(self._firsts[-1])

    @property
    def steps(self) -> int:
        """How many control steps there are."""
        return sum(one.steps for one in self.trajectories)

    @property
    def nbytes(self) -> int:
        """Bytes in memory."""
        return sum(one.nbytes for one in self.trajectories)

    def add(self, one: Trajectory) -> None:
        """Take one more trajectory."""
        self.trajectories.append(one)
        images = int(one.frame_of[-1]) + 1
        self._firsts = np.append(self._firsts, self._firsts[-1] + images)

    def moments(self) -> dict[str, NDArray[np.float32]]:
        """Return mean and standard deviation of body and labels, and the mean image.

        What hardly varies is divided by a little more than its deviation.
        """
        body = _moments([one.body for one in self.trajectories])
        labels = _moments([one.labels for one in self.trajectories])
        means = [self._mean_image(name) for name in self._cameras]
        arrays = {
            "body_mean": body[0],
            "body_std": body[1],
            "label_mean": labels[0],
            "label_std": labels[1],
            "image": np.concatenate([np.tile(m, (self._frames, 1, 1)) for m in means]),
        }
        return {name: array.astype(np.float32) for name, array in arrays.items()}

    def _mean_image(self, camera: str) -> NDArray[np.float64]:
        """Return the mean image of a camera, 0 to 1."""
        total = sum(getattr(one, camera).sum(0, dtype=np.float64) for one in self.trajectories)
        return np.asarray(total) / (255.0 * self.images)

    def draw(self, rng: np.random.Generator, images: int) -> Minibatch:
        """Return a batch of so many images, each as likely as any other."""
        chosen = rng.integers(0, self.images, images)
        owners = np.searchsorted(self._firsts, chosen, side="right") - 1
        stacks: dict[str, list[NDArray[np.uint8]]] = {name: [] for name in self._cameras}
        rows: list[_Rows] = []
        for index, (owner, number) in enumerate(zip(owners, chosen, strict=True)):
            one = self.trajectories[owner]
            frame = int(number - self._firsts[owner])
            # The first image stands for those before it, as on the card.
            wanted = np.maximum(np.arange(frame - self._frames + 1, frame + 1), 0)
            for name, stack in stacks.items():
                picked = getattr(one, name)[wanted]
                stack.append(picked.reshape(-1, *picked.shape[2:]))
            rows.append(_rows(one, frame, index, self._chunk))
        return Minibatch(
            images={name: np.stack(stack) for name, stack in stacks.items()},
            image_of=np.concatenate([row.image_of for row in rows]),
            body=np.concatenate([row.body for row in rows]),
            labels=np.concatenate([row.labels for row in rows]),
            is_there=np.concatenate([row.is_there for row in rows]),
        )


_LEAST = 1e-2
"""Standard deviation below which a number is taken not to vary."""


def _moments(rows: list[NDArray[np.float32]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and standard deviation over all rows, without a copy of all of them."""
    count = sum(map(len, rows))
    mean = np.sum([part.sum(0, dtype=np.float64) for part in rows], axis=0) / count
    squares = np.sum([((part - mean) ** 2).sum(0) for part in rows], axis=0) / count
    return mean, np.maximum(np.sqrt(squares), _LEAST)


@dataclass(frozen=True, kw_only=True)
class _Rows:
    image_of: NDArray[np.int64]
    body: NDArray[np.float32]
    labels: NDArray[np.float32]
    is_there: NDArray[np.bool_]


def _rows(one: Trajectory, frame: int, index: int, chunk: int) -> _Rows:
    """Return the steps of a trajectory that have an image as their newest."""
    first, end = np.searchsorted(one.frame_of, [frame, frame + 1])
    steps = np.arange(first, end)
    ahead = steps[:, None] + np.arange(chunk)
    return _Rows(
        image_of=np.full(len(steps), index, np.int64),
        body=one.body[first:end],
        labels=one.labels[np.minimum(ahead, one.steps - 1)],
        is_there=ahead < one.steps,
    )
