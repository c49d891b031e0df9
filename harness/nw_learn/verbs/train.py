"""`nw-eval train`: a policy by a training program, or one taken out of a training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_base.clean import clean
from nw_eval.cli.terminal.interruption import INTERRUPTED

if TYPE_CHECKING:
    from nw_learn.progress import Trained


@dataclass(frozen=True, kw_only=True)
class Program:
    """A training program. Subclasses have `_train` and `_go_on`."""

    config: tyro.conf.Positional[str | None] = None
    """A config file or a shipped config's name. Optional with --resume."""
    out: Path | None = None
    """The training's folder (default: `runs/<config's name>`)."""
    resume: Path | None = None
    """Resume the training in this folder."""

    def __call__(self) -> int:
        from nw_base.errors import UsageError
        from nw_learn.config import find_config

        if self.resume is not None:
            if self.config is not None or self.out is not None:
                raise UsageError(
                    "--resume takes its settings from its folder", fix="drop CONFIG and --out"
                )
            return end_of_training(self._go_on(self.resume))
        if self.config is None:
            raise UsageError("no config", fix="name one, or resume a training: --resume FOLDER")
        config = find_config(self.config)
        out = self.out or Path("runs", config.stem)
        return end_of_training(self._train(config, out))

    def _train(self, config: Path, out: Path) -> Trained:
        raise NotImplementedError

    def _go_on(self, folder: Path) -> Trained:
        raise NotImplementedError

    @staticmethod
    def _say(line: str) -> None:
        print(line, flush=True)


@dataclass(frozen=True, kw_only=True)
class Teacher(Program):
    """Train a teacher: PPO on random courses and in the training scenes, from scandots."""

    def _train(self, config: Path, out: Path) -> Trained:
        from nw_learn.teacher.training import train_teacher

        return train_teacher(config, out, say=self._say)

    def _go_on(self, folder: Path) -> Trained:
        from nw_learn.teacher.training import resume_teacher

        return resume_teacher(folder, say=self._say)


@dataclass(frozen=True, kw_only=True)
class Student(Program):
    """Train a student: DAgger with ACT in the training scenes, from images.

    Each round writes a policy into the folder's `policies/`, and a blind copy of it that sees the
    mean training image.
    """

    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Processes that collect trajectories (default: one per core)."""

    def _train(self, config: Path, out: Path) -> Trained:
        from nw_eval.engine.how import check_workers
        from nw_learn.student.train import train_student

        check_workers(self.workers)
        return train_student(config, out, say=self._say, workers=self.workers)

    def _go_on(self, folder: Path) -> Trained:
        from nw_eval.engine.how import check_workers
        from nw_learn.student.train import resume_student

        check_workers(self.workers)
        return resume_student(folder, say=self._say, workers=self.workers)


@dataclass(frozen=True, kw_only=True)
class Export:
    """Export the policy of a teacher's checkpoint: its card, and its weights as ONNX."""

    folder: tyro.conf.Positional[Path]
    """The training's folder."""
    out: Path
    """The policy's folder, such as policies/mine."""
    checkpoint: int | None = None
    """Number of a saved checkpoint (default: the newest state)."""

    def __call__(self) -> int:
        from nw_learn.teacher.policy import export_checkpoint

        print(clean(f"{export_checkpoint(self.folder, self.checkpoint, self.out)} -> {self.out}"))
        return 0


def end_of_training(trained: Trained) -> int:
    """Say how far a training came and how to go on; return the exit code."""
    if not trained.is_done:
        more = f"resume with: nw-eval train {trained.program} --resume {trained.folder}"
        print(clean(f"stopped after {trained.step:,} steps; {more}"))
    print(clean(f"policy: {trained.policy}"))
    return INTERRUPTED if trained.is_interrupted else 0
