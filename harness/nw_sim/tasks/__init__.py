"""Tasks: what a robot is to do in a trial, by name: built-in kinds, and those of packages.

A suite says `task: course`, or `task: {kind: course}` with the keys of that kind. What is not built
in is looked for among the entry points of `nw_eval.tasks`: nothing of a package is imported before
a suite names it. Built-in names always win.
"""

from __future__ import annotations

from typing import Annotated, Any, Self, cast

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Tag,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from nw_base.errors import NwEvalError, PluginError, UsageError, nearest
from nw_base.files.yaml_file import explain_limit
from nw_base.plugins import TASKS, installed, is_elsewhere, load_class, subject
from nw_gate.scores import ScoreSpec
from nw_sim.tasks.course import COURSE, Course, CourseSettings, Limits
from nw_sim.tasks.push import PushSettings, PushTask
from nw_sim.tasks.task import (
    Goal,
    Place,
    Readings,
    StartPose,
    Streams,
    Task,
    TaskEvent,
    TaskFault,
    TaskRules,
    TaskSettings,
)
from nw_sim.tasks.track import TrackSettings, TrackTask
from nw_sim.tasks.velocity import StandSettings, StandTask, VelocitySettings, VelocityTask

__all__ = [
    "COURSE",
    "AnyTask",
    "Course",
    "CourseSettings",
    "Goal",
    "Limits",
    "Place",
    "Readings",
    "StartPose",
    "Streams",
    "Task",
    "TaskEvent",
    "TaskFault",
    "TaskRules",
    "TaskSettings",
    "TrackSettings",
    "fault_of",
    "open_task",
    "task_kinds",
]


_CLASSES: tuple[type[Task], ...] = (Course, VelocityTask, PushTask, StandTask, TrackTask)
BUILT_IN: dict[str, type[Task]] = {cls.kind: cls for cls in _CLASSES}
"""By name."""
_PLUGIN = "plug-in"


class PluginTask(TaskSettings):
    """A task of an installed package, with whatever keys its own settings have."""

    model_config = ConfigDict(extra="allow")

    @model_validator(mode="after")
    def _valid(self, info: ValidationInfo) -> Self:
        if is_elsewhere(TASKS, self.kind, (info.context or {}).get("plugins", {})):
            return self
        try:
            _plugin(self.kind).settings.model_validate(self.model_dump())
        except ValidationError as error:
            first = error.errors()[0]
            location = ".".join(["task", *(str(part) for part in first["loc"])])
            why = explain_limit(first) or first["msg"].lower()
            raise ValueError(f"{location}: {why}") from None
        except NwEvalError as error:
            raise ValueError(str(error)) from None
        return self


def _branch(value: Any) -> str:
    fields = cast("dict[str, Any]", value) if isinstance(value, dict) else {}
    kind = fields.get("kind") if fields else getattr(value, "kind", None)
    return kind if isinstance(kind, str) and kind in BUILT_IN else _PLUGIN


def _by_name(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


AnyTask = Annotated[
    Annotated[CourseSettings, Tag("course")]
    | Annotated[VelocitySettings, Tag("velocity")]
    | Annotated[PushSettings, Tag("push")]
    | Annotated[StandSettings, Tag("stand")]
    | Annotated[TrackSettings, Tag("track")]
    | Annotated[PluginTask, Tag(_PLUGIN)],
    Discriminator(_branch),
    BeforeValidator(_by_name, json_schema_input_type=Any),
]
"""What a suite's `task` may be."""


def task_kinds() -> tuple[str, ...]:
    """Return the names of all kinds, the built-in ones first."""
    return (*BUILT_IN, *sorted(installed(TASKS).keys() - BUILT_IN.keys()))


def declared_by(settings: TaskSettings) -> tuple[ScoreSpec, ...]:
    """Return the scores that the task of a suite has of its own."""
    return declared_by_kind(settings.kind)


def declared_by_kind(kind: str) -> tuple[ScoreSpec, ...]:
    """Return the scores that a kind of task has of its own.

    Raises:
        UsageError: there is no such kind.
        PluginError: its package is broken.
    """
    return (BUILT_IN.get(kind) or _plugin(kind)).declared


def fault_of(
    settings: TaskSettings, *, hears: frozenset[str], rules: TaskRules
) -> TaskFault | None:
    """Return why a suite cannot run its task with a policy; None where it can.

    Args:
        settings: of the suite.
        hears: as `Task.fault` has it.
        rules: of the suite's trials.

    Raises:
        PluginError: the package of its kind is broken.
    """
    if "motion" in hears and settings.kind != TrackTask.kind:
        return TaskFault(
            ("kind",),
            f"the policy tracks the motion of its card, and not what {settings.kind} asks for",
            "write task: track",
        )
    if (built_in := BUILT_IN.get(settings.kind)) is not None:
        return built_in.fault(settings, hears=hears, rules=rules)
    cls = _plugin(settings.kind)
    return cls.fault(cls.settings.model_validate(settings.model_dump()), hears=hears, rules=rules)


def open_task(settings: TaskSettings, rules: TaskRules) -> Task:
    """Return a new task, before its `reset`.

    Args:
        settings: from a suite.
        rules: of the suite's trials.

    Raises:
        UsageError: there is no such kind.
        PluginError: its package is broken, or its class refuses.
    """
    if (built_in := BUILT_IN.get(settings.kind)) is not None:
        return built_in(settings, rules)  # pyright: ignore[reportCallIssue]  # As every class.
    cls = _plugin(settings.kind)
    try:
        return cls(cls.settings.model_validate(settings.model_dump()), rules)  # pyright: ignore[reportCallIssue]
    except Exception as error:
        raise PluginError(
            f"{_subject(settings.kind)} cannot be opened: {type(error).__name__}: {error}",
            fix="its class must take (settings, rules)",
        ) from error


def _subject(kind: str) -> str:
    return subject(installed(TASKS)[kind][0])


def _plugin(kind: str) -> type[Task]:
    """Return the class of a kind that is not built in.

    Raises:
        UsageError: there is no such kind.
        PluginError: its package is broken, or the class is no task.
    """
    if kind not in installed(TASKS):
        raise UsageError(f"{kind!r} is not a kind of task", fix=nearest(kind, task_kinds()))
    cls: Any = load_class(TASKS, kind, Task, lambda cls: getattr(cls, "kind", None))
    settings = getattr(cls, "settings", None)
    if not (isinstance(settings, type) and issubclass(settings, TaskSettings)):
        raise PluginError(
            f"{_subject(kind)} has no `settings`",
            fix="give it a subclass of nw_sim.tasks.TaskSettings",
        )
    return cls
