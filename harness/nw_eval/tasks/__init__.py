"""Tasks: what a robot is to do in a trial."""

from nw_eval.tasks.course import COURSE, Course, CourseSettings, Limits
from nw_eval.tasks.registry import AnyTask, fault_of, open_task, task_kinds
from nw_eval.tasks.task import (
    Goal,
    Place,
    Readings,
    Streams,
    Task,
    TaskEvent,
    TaskFault,
    TaskRules,
    TaskSettings,
)

__all__ = [
    "COURSE",
    "AnyTask",
    "Course",
    "CourseSettings",
    "Goal",
    "Limits",
    "Place",
    "Readings",
    "Streams",
    "Task",
    "TaskEvent",
    "TaskFault",
    "TaskRules",
    "TaskSettings",
    "fault_of",
    "open_task",
    "task_kinds",
]
