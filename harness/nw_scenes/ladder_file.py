"""Folders that are ladders: `ladder.yaml` lists scene folders, each with its value."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside, what_is
from nw_base.files.yaml_file import (
    YamlProblems,
    json_schema_of,
    read_yaml,
    validation_problems,
)
from nw_scenes.limits import checked_name

LADDER_FILE = "ladder.yaml"
_MOST = 100
_SAME = 1e-9
"""Values that are nearer to each other than this are one."""

Line = Annotated[str, AfterValidator(lambda text: clean(text, at_most=200))]


class _Model(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )


class _Rung(_Model):
    """One scene of a ladder."""

    value: float = Field(ge=-1e6, le=1e6)
    """Of the parameter, in the ladder's unit."""
    scene: str
    """A scene folder inside the ladder's."""


class _LadderFile(_Model):
    """`ladder.yaml`: scenes that differ by one number."""

    version: Literal[1] = Field(alias="nw-ladder")
    """Version of this format."""
    name: Annotated[str, AfterValidator(checked_name)]
    """Up to four words with slashes between, each of letters, digits, '_', '-' and '.'."""
    title: Line = ""
    """One line for people (default: the name)."""
    parameter: Line
    """What the number is, such as `height of the step`."""
    unit: Line = ""
    """Of the number, such as m; empty for a plain one."""
    harder: Literal["up", "down"] = "up"
    """Whether greater or smaller values are harder."""
    rungs: tuple[_Rung, ...] = Field(min_length=2, max_length=_MOST)
    """The scenes, in the order of their values."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        values = [each.value for each in self.rungs]
        if any(later - before <= _SAME for before, later in pairwise(values)):
            raise ValueError("the values of rungs are not in ascending order, each once; sort them")
        return self


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of `ladder.yaml`."""
    return json_schema_of(_LadderFile) | {"title": "nw-eval ladder"}


@dataclass(frozen=True, kw_only=True)
class FolderLadder:
    """A ladder of a folder.

    Attributes:
        folder: that holds `ladder.yaml`.
        name: that it gives itself.
        title: one line for people.
        parameter: what the number is.
        unit: of it; empty for a plain number.
        harder: whether greater or smaller values are harder.
        rungs: value and scene folder of each, from easy to hard.
    """

    folder: Path
    name: str
    title: str
    parameter: str
    unit: str
    harder: Literal["up", "down"]
    rungs: tuple[tuple[float, Path], ...]

    def scene(self, value: float) -> Path:
        """Return the scene folder of a value.

        Raises:
            SceneError: no rung has it; with those that there are.
        """
        for each, folder in self.rungs:
            if abs(each - value) <= _SAME:
                return folder
        known = ", ".join(f"{each:g}" for each, _ in self.rungs)
        raise SceneError(
            f"{self.folder}@{value:g}: the ladder has no such rung", fix=f"its rungs are {known}"
        )


def is_ladder(folder: Path) -> bool:
    """Whether a folder has a `ladder.yaml`."""
    return what_is(folder / LADDER_FILE) == "file"


def load_ladder(folder: Path) -> FolderLadder:
    """Return the ladder of a folder; its scenes are not opened.

    Raises:
        SceneError: the file is missing or wrong, or the folder of a rung lies outside or is none;
            every problem found, with file and line.
    """
    try:
        file = read_yaml(folder / LADDER_FILE)
    except YamlProblems as error:
        raise SceneError(error.problems) from None
    try:
        text = _LadderFile.model_validate(file.data)
    except ValidationError as error:
        raise SceneError(validation_problems(error, file, _LadderFile)) from None
    rungs: list[tuple[float, Path]] = []
    problems = []
    for index, each in enumerate(text.rungs):
        at = ("rungs", index, "scene")
        try:
            scene = inside(folder, each.scene)
        except OutsideError as error:
            fix = "name a folder inside the ladder's"
            problems.append(file.problem(at, f"scene {each.scene!r}: {error}", fix))
            continue
        if what_is(scene) != "folder":
            message = f"scene {each.scene!r} is not a folder"
            problems.append(file.problem(at, message, "name a scene folder"))
        rungs.append((each.value, scene))
    if problems:
        raise SceneError(problems)
    return FolderLadder(
        folder=folder,
        name=text.name,
        title=text.title or text.name,
        parameter=text.parameter,
        unit=text.unit,
        harder=text.harder,
        rungs=tuple(rungs if text.harder == "up" else reversed(rungs)),
    )
