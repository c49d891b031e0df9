"""What the verbs of all training programs have: a config, or a folder to go on with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    from nw_eval.learn.progress import Trained


@dataclass(frozen=True, kw_only=True)
class Program:
    """A training program. Subclasses have `_train` and `_go_on`."""

    config: tyro.conf.Positional[str | None] = None
    """A config file, or the name of a shipped one; a folder to resume has its own."""
    out: Path | None = None
    """The folder of the training; `runs/<config's name>` when absent."""
    resume: Path | None = None
    """Go on with the training in this folder."""

    def __call__(self) -> int:
        from nw_eval.cli.verbs.training.ends import end_of_training
        from nw_eval.errors import UsageError
        from nw_eval.learn.config import find_config

        if self.resume is not None:
            if self.config is not None or self.out is not None:
                raise UsageError(
                    "--resume goes on as its folder says", fix="leave CONFIG and --out out"
                )
            return end_of_training(self._go_on(self.resume))
        if self.config is None:
            raise UsageError("no config", fix="name one, or a folder to go on with: --resume")
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
