"""Configs of studies: who is trained where, and how it is evaluated."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from nw_eval.learn.program.config import ConfigFile, ConfigModel
from nw_eval.learn.student.config import Sees, StudentConfig
from nw_eval.suite.digest import digest_of

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,55}$")]
Patterns = Annotated[list[str], Field(min_length=1)]

_OF_THE_STUDY = {"version": "nw-train", "seed": "seed", "name": "name", "scenes": "scenes"}


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
    """Names the pinned panel of starts, as the seed of a suite does."""
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
    """Scenes in which nobody was trained."""
    by_task: bool = False
    """Whether each task has a student of its own, trained and evaluated in its scenes alone."""


class ObservationsConfig(StudyConfig):
    """Students that are given different things, all else being equal."""

    study: Literal["observations"]
    held_out: Patterns = Field(default=["split:eval"])
    """Scenes in which nobody was trained."""
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
