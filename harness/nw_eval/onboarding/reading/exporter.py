"""Metadata that the exporters of mjlab and Isaac Lab write into ONNX files.

Lists are joined by commas, numbers with three decimals; a scalar is written as it is. An entry of a
list that is a list itself is joined by semicolons: mjlab writes a clip as `-100.000;100.000`, and a
scale for each number of a term as `0.500;0.250`. Brackets and quotes, which some forks add, are
taken off.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nw_eval.onboarding.reading.text import plain


@dataclass(frozen=True, kw_only=True)
class ExportedTerm:
    """A term of the observation; None where the file does not say, or cannot be read."""

    name: str
    scale: tuple[float, ...] | None = None
    """Factor after clipping: one for all numbers of the term, or one each."""
    clip: tuple[float, float] | None = None
    """Limits before scaling; infinite where a side has none."""
    history: int | None = None
    """Frames, the present one included: at least 1."""
    flat_history: bool | None = None
    """Whether its frames are one row of numbers, oldest first."""


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
    observation_terms: tuple[ExportedTerm, ...] = ()
    """In the order in which they are joined."""


_NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
_NAMES = ("joint_names", "observation_names")
_LONGEST = 10_000  # Characters of a list of terms; splitting takes the square of them.


def read_exporter_metadata(entries: Mapping[str, str]) -> ExporterMetadata | None:
    """Return the metadata of a file, or None if neither exporter wrote it.

    What cannot be read is left out, as if it were not there.
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
        observation_terms=_terms(_names(text["observation_names"]), entries),
    )


def _terms(names: Sequence[str], entries: Mapping[str, str]) -> tuple[ExportedTerm, ...]:
    def column(key: str) -> Sequence[str | None]:
        return _entries(entries.get(f"observation_terms_{key}", ""), len(names))

    columns = zip(
        names,
        column("scale"),
        column("clip"),
        column("history_length"),
        column("flatten_history_dim"),
        strict=True,
    )
    return tuple(
        ExportedTerm(
            name=name,
            scale=_scale(scale),
            clip=_clip(clip),
            history=_history(history),
            flat_history=_flag(flat),
        )
        for name, scale, clip, history, flat in columns
    )


def _entries(text: str, count: int) -> Sequence[str | None]:
    """Return the entries of a list, one for each term; of another length it says nothing."""
    if len(text) > _LONGEST:
        return [None] * count
    for whole in (text, text.strip()[1:-1]):
        entries = [entry.strip() for entry in re.split(r",(?![^\[(]*[\])])", whole)]
        # A bracket that opens in one entry and closes in another is that of the whole list.
        closed = all(len(re.findall(r"[\[(]", e)) == len(re.findall(r"[\])]", e)) for e in entries)
        if closed and len(entries) == count and text.strip():
            return entries
    return [None] * count


def _parts(entry: str | None) -> tuple[float, ...] | None:
    try:
        return tuple(float(part) for part in re.split(r"[;,\s]+", (entry or "").strip("[]() ")))
    except ValueError:
        return None


def _is_none(entry: str | None) -> bool:
    return (entry or "").lower() in {"none", "null"}


def _scale(entry: str | None) -> tuple[float, ...] | None:
    numbers = (1.0,) if _is_none(entry) else _parts(entry)
    return numbers if numbers and all(math.isfinite(number) for number in numbers) else None


def _clip(entry: str | None) -> tuple[float, float] | None:
    numbers = (-math.inf, math.inf) if _is_none(entry) else _parts(entry)
    # NaN fails the comparison too.
    return numbers if numbers and len(numbers) == 2 and numbers[0] < numbers[1] else None


def _history(entry: str | None) -> int | None:
    numbers = (0.0,) if _is_none(entry) else _parts(entry)
    if not numbers or len(numbers) != 1 or numbers[0] not in range(101):
        return None
    return max(int(numbers[0]), 1)  # Both exporters write 0 for a term without history.


def _flag(entry: str | None) -> bool | None:
    return {"true": True, "false": False, "1": True, "0": False}.get(
        re.sub(r"\.0*$", "", (entry or "").lower())
    )


def _names(text: str) -> tuple[str, ...]:
    parts = (plain(part) for part in text.strip().strip("[]()").split(","))
    return tuple(item for item in (part.strip("'\"") for part in parts) if item)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(item) for item in _names(text))
    except ValueError:
        return ()
    return numbers if all(math.isfinite(number) for number in numbers) else ()
