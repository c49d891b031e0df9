"""`nw-eval train teacher`: a policy that is told the heights around it, by PPO."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True, kw_only=True)
class Teacher:
    """Train a teacher: PPO on random courses and in the training scenes, from scandots."""

    config: tyro.conf.Positional[Path | None] = None
    """What to train, such as training/teacher.yaml; with --resume the folder has its own."""
    out: Path | None = None
    """The folder of the training; `training/runs/<config's name>` when absent."""
    resume: Path | None = None
    """Go on with the training in this folder."""

    def __call__(self) -> int:
        from nw_eval.cli.verbs.training.ends import end_of_training
        from nw_eval.errors import UsageError
        from nw_eval.learn.teacher.training import resume_teacher, train_teacher

        if self.resume is not None:
            if self.config is not None or self.out is not None:
                raise UsageError(
                    "--resume goes on as its folder says", fix="leave CONFIG and --out out"
                )
            return end_of_training(resume_teacher(self.resume, say=_say))
        if self.config is None:
            raise UsageError("no config", fix="name one, or a folder to go on with: --resume")
        out = self.out or Path("training", "runs", self.config.stem)
        return end_of_training(train_teacher(self.config, out, say=_say))


def _say(line: str) -> None:
    print(line, flush=True)
