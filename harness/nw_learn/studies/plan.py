"""What a study consists of: its config, its students, and the scenes that each is evaluated in."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import Field, model_validator

from nw_base.digest import digest_of
from nw_base.errors import UsageError
from nw_learn.config import ConfigFile, ConfigModel
from nw_learn.student.config import Sees, StudentConfig
from nw_learn.student.driving import training_scenes
from nw_sim.catalogue import FoundScene, references

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,55}$")]
Patterns = Annotated[list[str], Field(min_length=1)]

_OF_THE_STUDY = {"version": "nw-train", "seed": "seed", "name": "name", "scenes": "scenes"}

Part = Literal["training", "evaluation"]
"""Of a study's scenes: those that students are trained in, and those that no student has seen."""


class Recipe(StudentConfig):
    """The config of every student of a study, less what the study says of each."""

    version: Literal[1] = Field(default=1, alias="nw-train")
    seed: int = 0
    name: str = "student"

    @model_validator(mode="after")
    def _of_students_alone(self) -> Recipe:
        for field in sorted(self.model_fields_set & set(_OF_THE_STUDY)):
            key = _OF_THE_STUDY[field]
            raise ValueError(f"{key!r} is the study's to say; take it out of here")
        return self


class Trials(ConfigModel):
    """How students are evaluated: as `nw-eval run` does it, all from the same starts."""

    trials: int = Field(ge=2, le=10_000)
    """In each scene. One alone has no interval."""
    seed: int = Field(default=20261, ge=0, lt=2**63)
    """Names the pinned seed set, as the seed of a suite does."""
    duration: float = Field(default=20.0, gt=0.0, le=600.0)
    """Longest simulated time of a trial, s."""


class StudyConfig(ConfigFile):
    """What the config of every study says."""

    version: Literal[1] = Field(alias="nw-study")
    """Version of this format."""
    name: Name
    """Of the study: a-z, 0-9, '.', '_' and '-'."""
    seed: int = Field(ge=0, lt=2**63)
    """Of every student's training."""
    scenes: Patterns
    """Where students are trained: names, globs and folders as in suites."""
    student: Recipe
    """How each is trained."""
    evaluation: Trials

    @property
    def fields(self) -> dict[str, Any]:
        """What a file says that loads to an equal config, defaults written out."""
        excluded: Any = {"student": set(_OF_THE_STUDY)}
        return self.model_dump(mode="json", by_alias=True, exclude=excluded)

    @property
    def digest(self) -> str:
        """Hex sha256 of what decides the study's numbers: all but the device and the minutes."""
        fields = self.fields
        del fields["student"]["device"], fields["student"]["budget"]["minutes"]
        return digest_of(fields)


class SingleSceneConfig(StudyConfig):
    """A student for each scene, each evaluated in all of them."""

    study: Literal["single-scene"]


class MultiSceneConfig(StudyConfig):
    """A student of all scenes, evaluated after each round, in scenes that it has not seen too."""

    study: Literal["multi-scene"]
    held_out: Patterns = Field(default=["split:eval"])
    """Scenes in which no student was trained."""
    by_task: bool = False
    """Whether each task has a student of its own, trained and evaluated in its scenes alone."""


class ObservationsConfig(StudyConfig):
    """Students that are given different things, all else being equal."""

    study: Literal["observations"]
    held_out: Patterns = Field(default=["split:eval"])
    """Scenes in which no student was trained."""
    variants: dict[Name, Sees] = Field(min_length=2, max_length=12)
    """What each student is given, by its name; the others are compared with the first."""

    @property
    def fields(self) -> dict[str, Any]:
        """As of every study; what students see stands in `variants` alone."""
        fields = super().fields
        del fields["student"]["sees"]
        return fields

    @model_validator(mode="after")
    def _said_once(self) -> ObservationsConfig:
        if "sees" in self.student.model_fields_set:
            raise ValueError(
                "what students see is said in `variants`; take `sees` out of `student`"
            )
        return self


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


C = TypeVar("C", bound=StudyConfig)


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
            scenes = references(getattr(config, field), config.base)
            changes[field] = [_written(*each) for each in scenes]
    return config.model_copy(update=changes)


def trained_in(config: StudyConfig) -> tuple[StudyScene, ...]:
    """Return the scenes in which students of a settled study are trained.

    Raises:
        SceneError, UsageError: as `training_scenes`; or a scene is one of the evaluation.
    """
    scenes = _scenes(training_scenes(config.scenes), "training")
    if left_out := set(config.scenes) - {each.reference for each in scenes}:
        raise UsageError(
            f"scenes: {min(left_out)} is an evaluation scene, which may not be used for training",
            fix="name scenes of `split:train`, or your own",
        )
    return scenes


def held_out(patterns: Sequence[str], seen: Iterable[StudyScene]) -> tuple[StudyScene, ...]:
    """Return the scenes in which students are evaluated and no student is trained.

    Raises:
        SceneError: a scene cannot be opened.
        UsageError: somebody is trained in one of them.
    """
    scenes = _scenes([FoundScene.at(*each) for each in references(patterns)], "evaluation")
    if both := {each.name for each in seen} & {each.name for each in scenes}:
        raise UsageError(
            f"held_out: students are trained in {min(both)}", fix="take it out of one of the lists"
        )
    return scenes


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


def slug(text: str) -> str:
    """Return words, such as a scene's name, as a student's name."""
    return re.sub(r"[^a-z0-9._]+", "-", text.lower()).strip("-._")[:48] or "scene"


def _scenes(scenes: Iterable[FoundScene], part: Part) -> tuple[StudyScene, ...]:
    return tuple(
        StudyScene(
            name=each.scene.name,
            task=each.scene.task,
            reference=_written(each.reference, each.collision),
            part=part,
        )
        for each in scenes
    )


def _written(reference: str, collision: str) -> str:
    return reference if collision == "terrain" else f"{collision}:{reference}"
