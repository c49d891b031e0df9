"""What other packages bring along: found by entry point, loaded by name, identified by version.

A package is installed by the user, so its code is trusted, and runs where the built-in code of its
kind runs. Looking a name up imports nothing of the package that has it; only what is named is
imported. Built-in names always win.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from nw_base.errors import PluginError, nearest

SENSORS = "nw_eval.sensors"
WRAPPERS = "nw_eval.wrappers"
AXES = "nw_eval.axes"
SPLAT_FORMATS = "nw_eval.splat_formats"
REPORTERS = "nw_eval.reporters"
ROBOTS = "nw_eval.robots"
TASKS = "nw_eval.tasks"
SCORES = "nw_eval.scores"
LADDERS = "nw_eval.ladders"
"""The entry-point groups."""

_Kind = TypeVar("_Kind")


class PluginWarning(UserWarning):
    """A plug-in that cannot be used, or whose name somebody else has."""


@cache
def installed(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of a group by name; several packages may claim one name."""
    points: dict[str, tuple[EntryPoint, ...]] = {}
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, distribution(p))):
        points[point.name] = (*points.get(point.name, ()), point)
    return points


def distribution(point: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return "unknown package" if point.dist is None else str(point.dist.name)


def subject(point: EntryPoint) -> str:
    """Return what messages call a plug-in: its name, its package and its entry point."""
    return f"plug-in {point.name!r} of {distribution(point)} ({point.value})"


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


def imported(group: str, name: str) -> object:
    """Import the value of an installed plug-in, whatever it is.

    Args:
        group: the entry-point group.
        name: of the plug-in, which `installed` has.

    Raises:
        PluginError: two packages claim the name, or the module cannot be imported. The message
            names package and entry point.
    """
    first, *others = installed(group)[name]
    if others:
        raise PluginError(
            f"{name!r} is claimed by two packages: {subject(first)} and {subject(others[0])}",
            fix="uninstall one of them",
        )
    try:
        return first.load()
    except Exception as error:
        raise PluginError(
            f"{subject(first)} cannot be imported: {type(error).__name__}: {error}",
            fix="fix or uninstall that package",
        ) from error


def load(group: str, name: str, kind: type[_Kind]) -> _Kind:
    """Import the value of an installed plug-in.

    Args:
        group: the entry-point group.
        name: of the plug-in, which `installed` has.
        kind: what the entry point must name an instance of, with its own name as `name`.

    Raises:
        PluginError: as `imported`, or the value is something else.
    """
    value = imported(group, name)
    called = getattr(value, "name", None)
    if not isinstance(value, kind):
        actual = f"a {type(value).__name__}, no nw_eval.{kind.__name__}"
    elif called != name:
        actual = f"the {kind.__name__} {called!r}"
    else:
        return value
    raise PluginError(
        f"{subject(installed(group)[name][0])} is {actual}",
        fix=f"the entry point {name!r} must name an nw_eval.{kind.__name__} with name={name!r}",
    )


def load_class(
    group: str, name: str, base: type[_Kind], own_name: Callable[[Any], object]
) -> type[_Kind]:
    """Import the class of an installed plug-in.

    Args:
        group: the entry-point group, which is the module that has `base`, too.
        name: of the plug-in, which `installed` has.
        base: what the entry point must name a subclass of.
        own_name: returns the name that such a class gives itself, which must be `name`.

    Raises:
        PluginError: as `imported`, or the value is something else.
    """
    value = imported(group, name)
    kind = f"{group}.{base.__name__}"
    if not (isinstance(value, type) and base in value.__mro__):
        actual = f"a {type(value).__name__}, no subclass of {kind}"
    elif (called := own_name(value)) != name:
        actual = f"the {base.__name__} {called!r}"
    else:
        return value
    raise PluginError(
        f"{subject(installed(group)[name][0])} is {actual}",
        fix=f"the entry point {name!r} must name a subclass of {kind} of that name",
    )


def warn_if_built_in(group: str, name: str) -> None:
    """Warn of each package that claims the name of something built in; it is ignored."""
    for point in installed(group).get(name, ()):
        warn(f"{subject(point)} is ignored: {name!r} is built in")


def usable(group: str, built_in: Collection[str]) -> dict[str, str]:
    """Return the plug-ins of a group that can be imported, by name, with their packages.

    The others are told in a `PluginWarning` each: broken ones with what went wrong, and those
    whose name is built in or taken.
    """
    packages: dict[str, str] = {}
    for name, points in installed(group).items():
        if name in built_in:
            warn_if_built_in(group, name)
            continue
        warn_of_rivals(points)
        try:
            points[0].load()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is that package's own.
            warn(f"{subject(points[0])} is broken: {type(error).__name__}: {error}")
        else:
            packages[name] = distribution(points[0])
    return packages


def warn_of_rivals(points: tuple[EntryPoint, ...]) -> None:
    """Warn of every package but the first that claims one name."""
    for point in points[1:]:
        owner = distribution(points[0])
        warn(f"{subject(point)} is ignored: {point.name!r} is taken by {owner}")


def warn(text: str) -> None:
    """Warn of a plug-in."""
    warnings.warn(text, PluginWarning, stacklevel=3)


def version_of(group: str, name: str) -> str | None:
    """Return `package version` of an installed plug-in; None where none has the name.

    Nothing of the package is imported.
    """
    points = installed(group).get(name)
    if not points:
        return None
    dist = points[0].dist
    return distribution(points[0]) if dist is None else f"{dist.name} {dist.version}"


def key_of(group: str, name: str) -> str:
    """Return what a plug-in is called in digests and in run.json, such as `axes.action_delay`."""
    return f"{group.partition('.')[2]}.{name}"


def is_measure(key: str) -> bool:
    """Whether what `key_of` calls so is a score, which changes no trial."""
    return key.startswith(key_of(SCORES, ""))


def version_named(key: str) -> str | None:
    """Return `version_of` what `key_of` calls so."""
    group, _, name = key.partition(".")
    return version_of(f"nw_eval.{group}", name)


def is_elsewhere(group: str, name: str, said: Mapping[str, str]) -> bool:
    """Whether a suite says another version of a plug-in than is installed here.

    Its run may have used the plug-in elsewhere, and is judged here: nothing of it is checked then.

    Args:
        group: the entry-point group.
        name: of the plug-in.
        said: `plugins` of the suite.
    """
    version = said.get(key_of(group, name))
    return version is not None and version != version_of(group, name)


def code_named(key: str) -> str:
    """Return `code_of` what `key_of` calls so."""
    group, _, name = key.partition(".")
    return code_of(f"nw_eval.{group}", name)


def identity_of(group: str, name: str) -> str:
    """Return `package version sha256` of an installed plug-in; empty where none has the name."""
    version = version_of(group, name)
    return "" if version is None else f"{version} {code_of(group, name)}"


def code_of(group: str, name: str) -> str:
    """Return the hex SHA-256 of a plug-in's Python files; empty where they cannot be found.

    They are all of those of the top-level module that its entry point names, which a version may
    not tell apart while somebody works on them. Nothing of the package is imported.
    """
    points = installed(group).get(name)
    if not points:
        return ""
    top = points[0].module.partition(".")[0]
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return ""
    if spec is None:
        return ""
    folders = [Path(folder) for folder in spec.submodule_search_locations or ()]
    files = [(path, folder) for folder in folders for path in sorted(folder.rglob("*.py"))]
    if not folders and spec.origin is not None:
        files = [(Path(spec.origin), Path(spec.origin).parent)]
    content = hashlib.sha256()
    try:
        for path, folder in files:
            content.update(path.relative_to(folder).as_posix().encode() + b"\0")
            content.update(hashlib.sha256(path.read_bytes()).digest())
    except OSError:
        return ""
    return content.hexdigest()
