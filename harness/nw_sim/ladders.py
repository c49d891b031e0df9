"""All ladders: what grows harder by one number, and the trials of each of its rungs.

A ladder is a built-in family of scenes (`hurdles/bar`, `hurdles/bar~1` in its second setting), a
folder with a `ladder.yaml`, one of an installed package (entry-point group `nw_eval.ladders`), or
an axis of perturbation on a fixed scene (`hurdles/three_low+payload`, `open/field+speed`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from nw_base.errors import SceneError, nearest
from nw_base.plugins import LADDERS, installed
from nw_places.entries import parted
from nw_places.ladders import FAMILIES, Family, steps, told
from nw_scenes.ladder_file import FolderLadder, is_ladder, load_ladder
from nw_sim.axes import COMMANDED, Axis, axis_named, is_axis
from nw_sim.catalogue import plugged_ladder, references

Harder = Literal["up", "down"]
Cell = tuple[tuple[str, float], ...]

COUNT = 14
"""Rungs of an axis for which none are published."""

_AXES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "friction": steps(0.70, 0.05, 0.05),
        "payload": steps(0.0, 13.0, 1.0),
        "push": steps(0.0, 2.6, 0.2),
        "latency": steps(0.0, 0.26, 0.02),
        "noise": steps(0.0, 0.26, 0.02),
        "fog": steps(0.0, 1.3, 0.1),
        "exposure": steps(1.0, 0.09, 0.07),
        "strength": steps(1.0, 0.35, 0.05),
        # Above what the tolerance of the task `velocity` passes of a robot that stands still.
        "speed": steps(0.3, 1.6, 0.1),
        "turn_rate": steps(0.4, 1.7, 0.1),
    }
)
"""Published values of axes, from easy to hard."""

FIXED = "hurdles/one_low_carpet"
"""The scene of listed ladders of perturbations; any other may be named."""
OPEN = "open/field"
"""The scene of listed ladders of commands; any other may be named."""


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One rung: where its trials run, and what is changed there.

    Attributes:
        value: of the ladder's parameter.
        scene: what a suite names.
        perturbation: axes with their values, a cell of `perturb`; empty for a ladder of scenes.
    """

    value: float
    scene: str
    perturbation: Cell = ()


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """A ladder.

    Attributes:
        name: what `rungs_of` takes.
        title: one line for people.
        parameter: what the number is.
        unit: of it; empty for a plain number.
        harder: whether greater or smaller values are harder.
        low: least value.
        high: greatest value.
        any_value: whether values between the rungs may be named, too.
        rungs: from easy to hard.
    """

    name: str
    title: str
    parameter: str
    unit: str
    harder: Harder
    low: float
    high: float
    any_value: bool
    rungs: tuple[Rung, ...]

    @property
    def is_commanded(self) -> bool:
        """Whether rungs are velocity commands, of the task `velocity`."""
        return any(axis in COMMANDED for axis, _ in self.rungs[0].perturbation)

    def told(self, value: float) -> str:
        """Return a value with its unit for people; angles in degrees, too."""
        return told(value, self.unit)


def ladders() -> tuple[Ladder, ...]:
    """Return the ladders that need no folder: built-in ones, those of packages, axes, commands.

    Raises:
        PluginError: a package's ladder cannot be imported.
        SceneError: a package's ladder cannot be read.
    """
    return (
        *(_of_family(family, None) for family in FAMILIES.values()),
        *(ladder_named(name) for name in installed(LADDERS) if name not in FAMILIES),
        *(_of_axis(OPEN if name in COMMANDED else FIXED, axis_named(name)) for name in _AXES),
    )


def rungs_of(name: str, base: Path | None = None) -> tuple[Rung, ...]:
    """Return the rungs of a ladder, from easy to hard; arguments and errors as `ladder_named`."""
    return ladder_named(name, base).rungs


def ladder_named(name: str, base: Path | None = None) -> Ladder:
    """Return a ladder by its name.

    Args:
        name: of a built-in ladder, with `~1` or `~2` in another setting; of a package's; a folder
            with a `ladder.yaml`; or `SCENE+AXIS`.
        base: folder that relative paths start from; the working folder by default.

    Raises:
        SceneError: there is no such ladder, or it cannot be read.
        PluginError: a package's ladder or axis cannot be imported.
        FetchError, PrerequisiteError, StoreError: its scene cannot be fetched.
    """
    family, number = parted(name)
    if family in FAMILIES:
        return _of_family(FAMILIES[family], number)
    if name in installed(LADDERS):
        return _of_folder(name, plugged_ladder(name))
    folder = (Path() if base is None else base) / name
    if is_ladder(folder):
        return _of_folder(name, load_ladder(folder))
    scene, plus, changed = name.rpartition("+")
    if plus and is_axis(changed):
        scenes = references([scene], base)
        if len(scenes) != 1:
            message = f"ladder {name!r} is on {len(scenes)} scenes"
            raise SceneError(message, fix="name one scene before the +")
        return _of_axis(scenes[0][0], axis_named(changed))
    known = [*FAMILIES, *installed(LADDERS), *(f"{FIXED}+{axis}" for axis in _AXES)]
    raise SceneError(
        f"there is no ladder {name!r}",
        fix=f"{nearest(name, known)}; or name a folder with a ladder.yaml, or SCENE+AXIS",
    )


def _of_family(family: Family, number: int | None) -> Ladder:
    rungs = [Rung(value=v, scene=family.entry(v, number).name) for v in family.rungs]
    name = family.name if number is None else f"{family.name}~{number}"
    return _ladder(name, family.title, family.parameter, family.unit, rungs, any_value=True)


def _of_folder(name: str, ladder: FolderLadder) -> Ladder:
    rungs = [Rung(value=value, scene=str(folder)) for value, folder in ladder.rungs]
    return _ladder(name, ladder.title, ladder.parameter, ladder.unit, rungs)


def _of_axis(scene: str, axis: Axis) -> Ladder:
    rungs = [
        Rung(value=value, scene=scene, perturbation=((axis.name, value),))
        for value in _AXES.get(axis.name, ()) or _towards_end(axis)
    ]
    parameter = axis.name.replace("_", " ")
    title = f"{scene} with another {parameter}"
    return _ladder(f"{scene}+{axis.name}", title, parameter, axis.unit, rungs, any_value=True)


def _towards_end(axis: Axis) -> tuple[float, ...]:
    """Return values from what changes nothing to the farther end of an axis's slider."""
    least, most, _ = axis.slides
    start = axis.reference
    end = most if most - start > start - least else least
    values = (start + (end - start) * index / (COUNT - 1) for index in range(COUNT))
    return tuple(dict.fromkeys(round(axis.nearest_step(value), 4) for value in values))


def _ladder(
    name: str,
    title: str,
    parameter: str,
    unit: str,
    rungs: list[Rung],
    *,
    any_value: bool = False,
) -> Ladder:
    values = [rung.value for rung in rungs]
    return Ladder(
        name=name,
        title=title,
        parameter=parameter,
        unit=unit,
        harder="up" if values[-1] > values[0] else "down",
        low=min(values),
        high=max(values),
        any_value=any_value,
        rungs=tuple(rungs),
    )
