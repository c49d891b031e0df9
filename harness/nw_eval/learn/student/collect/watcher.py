"""Looks on as somebody drives: what the student is given, and what the teacher would do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nw_eval.learn.student.card import BODY, DEPTH_STEPS
from nw_eval.learn.student.data.trajectory import Trajectory
from nw_eval.policies import open_policy
from nw_eval.rollout.episode import Observer
from nw_eval.sensors import build_sensors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from nw_eval.policies import Bundle, Observation
    from nw_eval.rollout.episode import Decision
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.prepare import OpenTrial
    from nw_eval.sensors.sensor import Sensor


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
