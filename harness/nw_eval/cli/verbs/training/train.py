"""`nw-eval train`: which program, or what to do with what it made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from nw_eval.cli.verbs.training.export import Export
from nw_eval.cli.verbs.training.student import Student
from nw_eval.cli.verbs.training.teacher import Teacher


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train a policy, or take one out of a training."""

    action: (
        Annotated[Teacher, tyro.conf.subcommand("teacher")]
        | Annotated[Student, tyro.conf.subcommand("student")]
        | Annotated[Export, tyro.conf.subcommand("export")]
    )

    def __call__(self) -> int:
        return self.action()
