"""The folder of a study: what it was begun with, its students, its runs, its figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from nw_eval.cards.load import CARD_FILE
from nw_eval.errors import IncomparableError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.learn.program.config import load_config
from nw_eval.learn.student.card import card_text as yaml_text
from nw_eval.learn.studies.config import StudyConfig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.learn.studies.plan import PlannedStudent

C = TypeVar("C", bound=StudyConfig)


class StudyFolder:
    """A study's folder.

    config.yaml                  as the study was begun, its scenes by name
    suite.yaml                   of all evaluations
    students/NAME.yaml           the student's config
    students/NAME/               its training, with its curve
    runs/NAME-round-N/           its evaluation after a round
    figure.png, table.parquet, table.md
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, config: StudyConfig, students: Sequence[PlannedStudent], suite: str) -> None:
        """Make the folder of a new study; its config comes last, so that it is whole or none.

        Raises:
            UsageError: a study is in it already.
            StoreError: it cannot be written.
        """
        if self.config.exists():
            raise UsageError(
                f"{self.path} holds a study already",
                fix=f"go on with it: --resume {self.path}, or choose another --out",
            )
        for student in students:
            fields = student.config.model_dump(mode="json", by_alias=True)
            _write(self.student_config(student.name), yaml_text(fields))
        _write(self.suite, suite)
        _write(self.config, yaml_text(config.fields))

    def saved(self, kind: type[C], config: C | None) -> C:
        """Return the config that the study was begun with.

        Args:
            kind: of the config.
            config: what it should be, settled, if that is known.

        Raises:
            UsageError: no study is in the folder, or one of another kind.
            IncomparableError: it is of another config.
        """
        if not self.config.is_file():
            raise UsageError(f"no study in {self.path}", fix="name a folder with a config.yaml")
        ours = load_config(self.config, kind)
        if config is not None and ours.digest != config.digest:
            raise IncomparableError(
                f"{self.path} is of another config: {ours.digest[:8]}, here it is "
                f"{config.digest[:8]}",
                fix="leave the config out, or begin in another --out",
            )
        return ours

    @property
    def config(self) -> Path:
        """The copy of the study's config."""
        return self.path / "config.yaml"

    @property
    def suite(self) -> Path:
        """The suite of all evaluations."""
        return self.path / "suite.yaml"

    @property
    def figure(self) -> Path:
        """The study's figure."""
        return self.path / "figure.png"

    @property
    def table(self) -> Path:
        """The numbers of the figure."""
        return self.path / "table.parquet"

    @property
    def page(self) -> Path:
        """The same for people."""
        return self.path / "table.md"

    def student_config(self, name: str) -> Path:
        """Return where a student's config is."""
        return self.path / "students" / f"{name}.yaml"

    def training(self, name: str) -> Path:
        """Return the folder of a student's training."""
        return self.path / "students" / name

    def policy(self, name: str, number: int) -> Path:
        """Return the folder of the policy that a student's round leaves."""
        return self.training(name) / "policies" / f"round-{number}"

    def is_trained(self, name: str, rounds: int) -> bool:
        """Say whether all rounds of a student have left their policy."""
        return (self.policy(name, rounds) / CARD_FILE).is_file()

    def run(self, name: str, number: int) -> Path:
        """Return the folder of the evaluation of a student after a round."""
        return self.path / "runs" / f"{name}-round-{number}"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
