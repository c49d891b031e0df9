"""Robots: one frozen specification each, with MJCF of our own written from published figures."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError, nearest
from nw_eval.robots.go1 import go1
from nw_eval.robots.go2 import go2
from nw_eval.robots.spec import CameraMount, RobotSpec, Shape

if TYPE_CHECKING:
    from collections.abc import Callable


__all__ = ["CameraMount", "RobotSpec", "Shape", "get_robot", "robot_names"]

_BUILDERS: dict[str, Callable[[], RobotSpec]] = {"go1": go1, "go2": go2}


def robot_names() -> tuple[str, ...]:
    """Return the names that `get_robot` knows, sorted."""
    return tuple(sorted(_BUILDERS))


@cache
def get_robot(name: str) -> RobotSpec:
    """Return the robot of that name.

    Args:
        name: for example `go1`.

    Raises:
        UsageError: no robot has that name; the message holds the nearest one.
    """
    if name not in _BUILDERS:
        raise UsageError(f"unknown robot {name!r}", fix=nearest(name, _BUILDERS))
    return _BUILDERS[name]()
