"""`nw-eval study`: train students of several kinds, evaluate them, and draw the results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from nw_eval.cli.verbs.shared import Workers

if TYPE_CHECKING:
    from nw_learn.studies.kinds import Kind


@dataclass(frozen=True, kw_only=True)
class _Options:
    """What all studies are given."""

    config: tyro.conf.Positional[str | None] = None
    """A config file, or a shipped config's name such as `single-scene-reduced`. Optional with
    --resume."""
    out: Path | None = None
    """The study's folder (default: `runs/<name>`)."""
    resume: Path | None = None
    """Resume the study in this folder; finished trainings and evaluations are kept."""
    workers: Workers = None

    def carry_out(self, kind: Kind) -> int:
        """Begin the study or go on with it, and say where its figure is."""
        from nw_eval.cli.terminal.final_output import tell
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_learn.config import find_config
        from nw_learn.studies.study import open_study

        study = open_study(
            kind,
            None if self.config is None else find_config(self.config, folder="studies"),
            out=self.out,
            resume=self.resume,
            say=tell,
            listening=RunProgress,
            workers=self.workers,
        )
        if not study.run():
            tell(f"not finished; resume with --resume {study.folder.path}")
            return INTERRUPTED
        print(study.folder.page.read_text(encoding="utf-8"))
        print(f"drawn in {study.folder.figure}")
        return 0


@dataclass(frozen=True, kw_only=True)
class SingleSceneStudy(_Options):
    """Train a student per scene and evaluate each in all scenes: a matrix of success."""

    def __call__(self) -> int:
        from nw_learn.studies.kinds import SingleScene

        return self.carry_out(SingleScene())


@dataclass(frozen=True, kw_only=True)
class MultiSceneStudy(_Options):
    """Train one student in many scenes and evaluate it after each round, in new scenes too."""

    def __call__(self) -> int:
        from nw_learn.studies.kinds import MultiScene

        return self.carry_out(MultiScene())


@dataclass(frozen=True, kw_only=True)
class ObservationsStudy(_Options):
    """Train students on different observations (colours, depth, cones, direction) and compare."""

    def __call__(self) -> int:
        from nw_learn.studies.kinds import Observations

        return self.carry_out(Observations())
