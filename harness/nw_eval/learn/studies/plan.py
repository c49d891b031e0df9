"""What a study consists of: students, and the scenes that each is evaluated in."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from nw_eval.catalogue import FoundScene, references
from nw_eval.errors import UsageError
from nw_eval.learn.student.config import StudentConfig
from nw_eval.learn.student.places import training_scenes
from nw_eval.learn.studies.config import StudyConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

C = TypeVar("C", bound=StudyConfig)
Part = Literal["training", "evaluation"]
"""Of a study's scenes: those that students are trained in, and those that nobody has seen."""


@dataclass(frozen=True, kw_only=True)
class StudyScene:
    """A scene of a study."""

    name: str
    task: str
    reference: str
    """What a suite calls it."""
    part: Part


@dataclass(frozen=True, kw_only=True)
class PlannedStudent:
    """A student, and how it will be evaluated."""

    config: StudentConfig
    scenes: tuple[StudyScene, ...]
    """That it is evaluated in."""
    rounds: tuple[int, ...]
    """After which it is."""
    label: str
    """What figures call it."""

    @property
    def name(self) -> str:
        """Of its policy and its folders; no other student of the study has it."""
        return self.config.name


def settled(config: C) -> C:
    """Return a config that means the same wherever it is read: patterns and paths resolved.

    Raises:
        SceneError: a pattern matches nothing.
    """
    teacher = config.base / config.student.teacher
    own = str(teacher.resolve()) if teacher.exists() else config.student.teacher
    changes: dict[str, Any] = {"student": config.student.model_copy(update={"teacher": own})}
    for field in ("scenes", "held_out"):
        if field in type(config).model_fields:
            found = references(getattr(config, field), config.base)
            changes[field] = [_written(*each) for each in found]
    return config.model_copy(update=changes)


def trained_in(config: StudyConfig) -> tuple[StudyScene, ...]:
    """Return the scenes in which students of a settled study are trained.

    Raises:
        SceneError, UsageError: as `training_scenes`; or a scene is one of the evaluation.
    """
    found = _scenes(training_scenes(config.scenes), "training")
    if left_out := set(config.scenes) - {each.reference for each in found}:
        raise UsageError(
            f"scenes: {min(left_out)} is an evaluation scene, in which nobody is trained",
            fix="name scenes of `split:train`, or your own",
        )
    return found


def held_out(patterns: Sequence[str], seen: Iterable[StudyScene]) -> tuple[StudyScene, ...]:
    """Return the scenes in which students are evaluated and nobody is trained.

    Raises:
        SceneError: a scene cannot be opened.
        UsageError: somebody is trained in one of them.
    """
    found = _scenes([FoundScene.at(*each) for each in references(patterns)], "evaluation")
    if both := {each.name for each in seen} & {each.name for each in found}:
        raise UsageError(
            f"held_out: students are trained in {min(both)}", fix="take it out of one of the lists"
        )
    return found


def student_of(
    config: StudyConfig, name: str, scenes: Sequence[StudyScene], **changes: Any
) -> StudentConfig:
    """Return the config of a student of a settled study.

    Args:
        config: of the study.
        name: of the student.
        scenes: that it is trained in.
        changes: other fields of the config.
    """
    recipe = config.student.model_dump(mode="json", by_alias=True)
    own = {
        "name": name,
        "seed": config.seed,
        "scenes": [each.reference for each in scenes],
    }
    return StudentConfig.model_validate(recipe | own | changes)


def slug(words: str) -> str:
    """Return words, such as a scene's name, as a student's name."""
    return re.sub(r"[^a-z0-9._]+", "-", words.lower()).strip("-._")[:48] or "scene"


def _scenes(found: Iterable[FoundScene], part: Part) -> tuple[StudyScene, ...]:
    return tuple(
        StudyScene(
            name=each.scene.name,
            task=each.scene.task,
            reference=_written(each.reference, each.collision),
            part=part,
        )
        for each in found
    )


def _written(reference: str, collision: str) -> str:
    return reference if collision == "terrain" else f"{collision}:{reference}"
