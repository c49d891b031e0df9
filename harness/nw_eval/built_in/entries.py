"""All built-in scenes, and further looks of each.

`gaps/two_stones_park~3` is a variant: the course of a scene in another's place. Sixteen places a
task are few to learn to see from: a network comes to know them by their floors. A variant has the
obstacles and the waypoints of its scene to the last bit, but place, light and materials of others
of the same task, so that what it looks like says nothing of where to step. Variants of training
scenes are made of training scenes alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from hashlib import sha256
from typing import Any

import numpy as np

from nw_eval.built_in.entry import Course, Entry
from nw_eval.built_in.gaps import GAPS
from nw_eval.built_in.grounds import GROUNDS
from nw_eval.built_in.hurdles import HURDLES
from nw_eval.built_in.ramps import RAMPS
from nw_eval.built_in.splits import split_of
from nw_eval.built_in.stairs import STAIRS

ENTRIES: tuple[Entry, ...] = (*HURDLES, *GAPS, *RAMPS, *STAIRS, *GROUNDS)

MOST = 99
"""Largest number of a variant."""

_VARIANT = re.compile(r"(?P<name>[^~]+)~(?P<number>[1-9][0-9]?)")
_MATERIALS = frozenset({"material", "top", "props", "body", "treads"})
"""Fields of courses that say what obstacles are made of, and no more."""


def parted(text: str) -> tuple[str, int | None]:
    """Return a name or pattern without the number of a variant, and the number; None without."""
    found = _VARIANT.fullmatch(text)
    return (text, None) if found is None else (found["name"], int(found["number"]))


def has_variants(name: str) -> bool:
    """Return whether there are others that a built-in scene's variants can be made of."""
    return split_of(name) is not None


def variant(name: str, number: int, entries: Mapping[str, Entry]) -> Entry:
    """Return a variant of a scene: the same whenever and wherever it is made.

    Args:
        name: of a scene that has variants.
        number: 1 to `MOST`.
        entries: all built-in scenes by name.
    """
    entry = entries[name]
    like = [
        other
        for other in sorted(entries.values(), key=lambda each: each.name)
        if other.name != name
        and other.task == entry.task
        and split_of(other.name) == split_of(name)
    ]
    seed = sha256(f"{name}~{number}".encode()).digest()
    random = np.random.default_rng(list(seed))
    place = like[int(random.integers(len(like)))]
    return replace(
        entry,
        name=f"{name}~{number}",
        title=f"{entry.title}, elsewhere: variant {number}",
        setting=place.setting,
        light=place.light,
        exposure=place.exposure,
        course=_painted(entry, like, random),
    )


def _painted(entry: Entry, like: Sequence[Entry], random: np.random.Generator) -> Course:
    """Return the course of a scene in the materials of another of its kind, if there is one."""
    same = [other.course for other in like if type(other.course) is type(entry.course)]
    if not same:
        return entry.course
    other = same[int(random.integers(len(same)))]
    course: Any = entry.course  # A dataclass, as all courses are.
    names = [each.name for each in fields(course) if each.name in _MATERIALS]
    return replace(course, **{each: getattr(other, each) for each in names})
