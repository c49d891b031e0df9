"""`nw-eval train student`: a policy that sees images, taught by one that is told heights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.cli.verbs.training.program import Program

if TYPE_CHECKING:
    from nw_eval.learn.progress import Trained


@dataclass(frozen=True, kw_only=True)
class Student(Program):
    """Train a student: DAgger with ACT in the training scenes, from images.

    Each round leaves a policy in the folder's `policies/`, and beside it the same one with its
    images frozen to the mean of those that it learnt from.
    """

    workers: int | None = None
    """Processes that drive trajectories; one for each core when absent."""

    def _train(self, config: Path, out: Path) -> Trained:
        from nw_eval.api.running.plans import check_workers
        from nw_eval.learn.student.train import train_student

        check_workers(self.workers)
        return train_student(config, out, say=self._say, workers=self.workers)

    def _go_on(self, folder: Path) -> Trained:
        from nw_eval.api.running.plans import check_workers
        from nw_eval.learn.student.train import resume_student

        check_workers(self.workers)
        return resume_student(folder, say=self._say, workers=self.workers)
