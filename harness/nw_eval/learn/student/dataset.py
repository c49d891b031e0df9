"""All trajectories so far, in memory, and batches of samples drawn from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nw_eval.learn.student.trajectory import Trajectory


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
        found = {
            "body_mean": body[0],
            "body_std": body[1],
            "label_mean": labels[0],
            "label_std": labels[1],
            "image": np.concatenate([np.tile(m, (self._frames, 1, 1)) for m in means]),
        }
        return {name: array.astype(np.float32) for name, array in found.items()}

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
        for place, (owner, number) in enumerate(zip(owners, chosen, strict=True)):
            one = self.trajectories[owner]
            frame = int(number - self._firsts[owner])
            # The first image stands for those before it, as on the card.
            wanted = np.maximum(np.arange(frame - self._frames + 1, frame + 1), 0)
            for name, stack in stacks.items():
                picked = getattr(one, name)[wanted]
                stack.append(picked.reshape(-1, *picked.shape[2:]))
            rows.append(_rows(one, frame, place, self._chunk))
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


def _rows(one: Trajectory, frame: int, place: int, chunk: int) -> _Rows:
    """Return the steps of a trajectory that have an image as their newest."""
    first, end = np.searchsorted(one.frame_of, [frame, frame + 1])
    steps = np.arange(first, end)
    ahead = steps[:, None] + np.arange(chunk)
    return _Rows(
        image_of=np.full(len(steps), place, np.int64),
        body=one.body[first:end],
        labels=one.labels[np.minimum(ahead, one.steps - 1)],
        is_there=ahead < one.steps,
    )
