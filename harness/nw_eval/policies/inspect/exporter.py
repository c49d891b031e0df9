"""Metadata that the exporters of mjlab and Isaac Lab write into ONNX files.

Lists are joined by commas, numbers with three decimals; a scalar is written as it is. Brackets and
quotes, which some forks add, are taken off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ExporterMetadata:
    """What the exporter knew; empty where the file does not say."""

    joint_names: tuple[str, ...] = ()
    joint_stiffness: tuple[float, ...] = ()
    """N m/rad, in the order of `joint_names`, as all lists of numbers here."""
    joint_damping: tuple[float, ...] = ()
    """N m s/rad."""
    default_joint_pos: tuple[float, ...] = ()
    """rad."""
    action_scale: tuple[float, ...] = ()
    """rad for each unit of action; one number for all joints, or one each."""
    observation_names: tuple[str, ...] = ()
    """Terms, in the order in which they are joined."""
    command_names: tuple[str, ...] = ()


_NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
_NAMES = ("joint_names", "observation_names", "command_names")


def read_exporter_metadata(entries: Mapping[str, str]) -> ExporterMetadata | None:
    """Return the metadata of a file, or None if neither exporter wrote it.

    A list of numbers that cannot be read is left out, as if it were not there.
    """
    if not any(name in entries for name in (*_NUMBERS, *_NAMES)):
        return None
    text = {name: entries.get(name, "") for name in (*_NUMBERS, *_NAMES)}
    return ExporterMetadata(
        joint_names=_names(text["joint_names"]),
        joint_stiffness=_numbers(text["joint_stiffness"]),
        joint_damping=_numbers(text["joint_damping"]),
        default_joint_pos=_numbers(text["default_joint_pos"]),
        action_scale=_numbers(text["action_scale"]),
        observation_names=_names(text["observation_names"]),
        command_names=_names(text["command_names"]),
    )


def _names(text: str) -> tuple[str, ...]:
    parts = text.strip().strip("[]()").split(",")
    return tuple(item for item in (part.strip().strip("'\"") for part in parts) if item)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(item) for item in _names(text))
    except ValueError:
        return ()
    return numbers if all(math.isfinite(number) for number in numbers) else ()
