"""Kinds of tasks by name: those that are built in, and those of installed packages.

A suite says `task: course`, or `task: {kind: course}` with the keys of that kind. What is not built
in is looked for among the entry points of `nw_eval.tasks`: nothing of a package is imported before
a suite names it. Built-in names always win.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any, Self, cast

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Tag,
    ValidationError,
    model_validator,
)

from nw_eval.errors import UsageError, nearest
from nw_eval.scores import ScoreSpec
from nw_eval.tasks.course import Course, CourseSettings
from nw_eval.tasks.task import Task, TaskRules, TaskSettings

TASKS = "nw_eval.tasks"
"""The entry-point group."""

_BUILT_IN: dict[str, type[Task]] = {cls.kind: cls for cls in (Course,)}
_PLUGIN = "plug-in"
_NEEDED = ("reset", "update", "end", "state", "restore")


class PluginTask(TaskSettings):
    """A task of an installed package, with whatever keys its own settings have."""

    model_config = ConfigDict(extra="allow")

    @model_validator(mode="after")
    def _valid(self) -> Self:
        cls = _plugin(self.kind)
        try:
            cls.settings.model_validate(self.model_dump())
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(["task", *(str(part) for part in first["loc"])])
            raise ValueError(f"{place}: {first['msg'].lower()}") from None
        return self

    def identity(self) -> dict[str, Any]:
        """Return its keys, with the package and its version: another one may be another task."""
        return {**self.model_dump(), "plug-in": _version(self.kind)}


def _branch(value: Any) -> str:
    found = cast("dict[str, Any]", value) if isinstance(value, dict) else {}
    kind = found.get("kind") if found else getattr(value, "kind", None)
    return kind if isinstance(kind, str) and kind in _BUILT_IN else _PLUGIN


def _by_name(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


AnyTask = Annotated[
    Annotated[CourseSettings, Tag("course")] | Annotated[PluginTask, Tag(_PLUGIN)],
    Discriminator(_branch),
    BeforeValidator(_by_name, json_schema_input_type=Any),
]
"""What a suite's `task` may be."""


def task_kinds() -> tuple[str, ...]:
    """Return the names of all kinds, the built-in ones first."""
    return (*_BUILT_IN, *sorted(_installed().keys() - _BUILT_IN.keys()))


def is_plugin(settings: TaskSettings) -> bool:
    """Whether a task is that of an installed package."""
    return settings.kind not in _BUILT_IN


def declared_by(settings: TaskSettings) -> tuple[ScoreSpec, ...]:
    """Return the scores that a kind of task has of its own."""
    cls = _BUILT_IN.get(settings.kind) or _plugin(settings.kind)
    return cls.declared


def open_task(settings: TaskSettings, rules: TaskRules) -> Task:
    """Return a new task, before its `reset`.

    Args:
        settings: from a suite.
        rules: of the suite's trials.

    Raises:
        UsageError: a plug-in cannot be imported, or its class refuses.
    """
    if (built_in := _BUILT_IN.get(settings.kind)) is not None:
        return built_in(settings, rules)  # pyright: ignore[reportCallIssue]  # As every class.
    try:
        cls = _plugin(settings.kind)
        return cls(cls.settings.model_validate(settings.model_dump()), rules)  # pyright: ignore[reportCallIssue]
    except ValueError as error:
        raise UsageError(str(error), fix="install its package, or repair it") from error
    except Exception as error:
        raise UsageError(
            f"{_subject(settings.kind)} cannot be opened: {type(error).__name__}: {error}",
            fix="its class must take (settings, rules)",
        ) from error


@cache
def _installed() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=TASKS), key=lambda p: (p.name, _owner(p))):
        found.setdefault(point.name, point)
    return found


def _owner(point: EntryPoint) -> str:
    return "unknown package" if point.dist is None else str(point.dist.name)


def _subject(kind: str) -> str:
    point = _installed().get(kind)
    return f"task {kind!r}" if point is None else f"task {kind!r} of {_owner(point)}"


def _version(kind: str) -> str:
    point = _installed().get(kind)
    return "" if point is None or point.dist is None else f"{_owner(point)} {point.dist.version}"


@cache
def _plugin(kind: str) -> type[Task]:
    """Return the class of an installed kind.

    Raises:
        ValueError: there is none, or it is no task.
    """
    point = _installed().get(kind)
    if point is None:
        known = {*_BUILT_IN, *_installed()}
        raise ValueError(f"{kind!r} is no kind of task; {nearest(kind, known)}")
    try:
        cls = point.load()
    except Exception as error:
        raise ValueError(
            f"{_subject(kind)} is broken: {type(error).__name__}: {error}; install it again"
        ) from error
    lacking = [name for name in _NEEDED if not callable(getattr(cls, name, None))]
    settings = getattr(cls, "settings", None)
    if not (isinstance(settings, type) and issubclass(settings, TaskSettings)):
        lacking.append("settings")
    if lacking:
        raise ValueError(f"{_subject(kind)} has no {', '.join(lacking)}; see docs/tasks.md")
    return cls
