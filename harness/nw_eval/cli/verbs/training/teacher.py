"""`nw-eval train teacher`: a policy that is told the heights around it, by PPO."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.cli.verbs.training.program import Program

if TYPE_CHECKING:
    from nw_eval.learn.progress import Trained


@dataclass(frozen=True, kw_only=True)
class Teacher(Program):
    """Train a teacher: PPO on random courses and in the training scenes, from scandots."""

    def _train(self, config: Path, out: Path) -> Trained:
        from nw_eval.learn.teacher.training import train_teacher

        return train_teacher(config, out, say=self._say)

    def _go_on(self, folder: Path) -> Trained:
        from nw_eval.learn.teacher.training import resume_teacher

        return resume_teacher(folder, say=self._say)
