"""Names of sensors and wrappers that other packages bring along.

Looking a name up imports nothing of the package that has it.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from nw_eval.errors import nearest

SENSORS = "nw_eval.sensors"
WRAPPERS = "nw_eval.wrappers"
"""The entry-point groups."""


@cache
def installed(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of a group by name; several packages may claim one name."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, distribution(p))):
        found[point.name] = (*found.get(point.name, ()), point)
    return found


def distribution(point: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return "unknown package" if point.dist is None else str(point.dist.name)


def is_code(name: str) -> bool:
    """Whether a name is `module:Class` rather than that of something installed."""
    return ":" in name


def known_or_raise(name: str, group: str, built_in: Collection[str]) -> None:
    """Check that a name is installed or `module:Class`.

    Raises:
        ValueError: it is neither.
    """
    if is_code(name):
        module, _, cls = name.partition(":")
        if not (all(part.isidentifier() for part in module.split(".")) and cls.isidentifier()):
            message = f"{name!r} is not a class; write package.module:Class"
            raise ValueError(message)
    elif name not in installed(group):
        message = f"{name!r} is not known; {nearest(name, {*built_in, *installed(group)})}"
        raise ValueError(message)
