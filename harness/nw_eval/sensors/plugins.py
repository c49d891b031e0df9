"""Classes of other packages: found by their installed name, or by `module:Class`.

Nothing of a package is imported before a card names it, so a broken one costs nobody else
anything. Built-in names always win.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Collection, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from nw_eval.cards.observations.plugins import distribution, installed, is_code
from nw_eval.errors import CodeError, NwEvalError, PolicyError
from nw_eval.files.importable import importable


class PluginWarning(UserWarning):
    """A plug-in that cannot be used, or whose name somebody else has."""


def make_plugin(
    name: str,
    group: str,
    arguments: tuple[Any, ...],
    parameters: Mapping[str, Any],
    *,
    code_from: Path | None,
) -> Any:
    """Import a plug-in's class and return an object of it.

    Args:
        name: as the card has it.
        group: the entry-point group.
        arguments: what every class of the group is called with.
        parameters: keyword arguments from the card.
        code_from: folder whose modules `module:Class` may name; None = it may name none.

    Raises:
        PolicyError: code is not allowed, or the plug-in is not installed.
        CodeError: the class cannot be imported, does not take these parameters, or can be saved
            but not restored. The message names the plug-in and its package.
    """
    if is_code(name):
        if code_from is None:
            raise PolicyError(
                f"{name!r} imports and runs Python code",
                fix="add --allow-code if you trust it",
            )
        subject = name
    else:
        points = installed(group).get(name)
        if not points:
            raise PolicyError(f"no installed plug-in {name!r}", fix="install its package again")
        _warn_of_rivals(points)
        subject = _subject(points[0])
    try:
        cls = _from_folder(name, code_from) if is_code(name) else installed(group)[name][0].load()
        plugin = cls(*arguments, **parameters)
    except NwEvalError:
        raise
    except Exception as error:
        where = f"in {code_from} or " if is_code(name) else ""
        raise CodeError(
            f"{subject} cannot be opened: {type(error).__name__}: {error}",
            fix=f"its module must be {where}installed, and its class take the card's parameters"
            + (f" {sorted(parameters)}" if parameters else ""),
        ) from error
    _check_memory(plugin, subject)
    return plugin


def remembers(plugin: Any) -> bool:
    """Whether a plug-in's object is a `Memory`."""
    return _has(plugin, "state") and _has(plugin, "restore")


def usable(group: str, built_in: Collection[str]) -> dict[str, str]:
    """Return the plug-ins of a group that can be imported, by name, with their packages.

    The others are told in a `PluginWarning` each: broken ones with what went wrong, and those
    whose name is built in or taken.
    """
    found: dict[str, str] = {}
    for name, points in installed(group).items():
        if name in built_in:
            for point in points:
                _warn(f"{_subject(point)} is ignored: {name!r} is built in")
            continue
        _warn_of_rivals(points)
        try:
            points[0].load()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is that package's own.
            _warn(f"{_subject(points[0])} is broken: {type(error).__name__}: {error}")
        else:
            found[name] = distribution(points[0])
    return found


def _warn_of_rivals(points: tuple[EntryPoint, ...]) -> None:
    for point in points[1:]:
        owner = distribution(points[0])
        _warn(f"{_subject(point)} is ignored: {point.name!r} is taken by {owner}")


def _check_memory(plugin: Any, where: str) -> None:
    if _has(plugin, "memory") and _has(plugin, "remember") and not remembers(plugin):
        raise CodeError(
            f"{where} has `memory` and `remember`, which nobody calls any more",
            fix="call them `state` and `restore`",
        )
    if _has(plugin, "state") != _has(plugin, "restore"):
        raise CodeError(
            f"{where} has only one of `state` and `restore`",
            fix="write both, or neither if it remembers nothing between samples",
        )


def _has(plugin: Any, method: str) -> bool:
    return callable(getattr(plugin, method, None))


def _subject(point: EntryPoint) -> str:
    return f"plug-in {point.name!r} of {distribution(point)} ({point.value})"


def _warn(text: str) -> None:
    warnings.warn(text, PluginWarning, stacklevel=3)


def _from_folder(name: str, folder: Path | None) -> Any:
    module, _, cls = name.partition(":")
    with importable(folder):
        return getattr(importlib.import_module(module), cls)
