"""What will give a scale, found in the first seconds of a build and kept for `align`.

The slow stages come later, so the user learns first whether the scene will be in metres, and
what to give if it will not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from nw_base.errors import PrerequisiteError, SceneError, UsageError, nearest
from nw_base.files.cache import atomic_path
from nw_base.files.inside import regular
from nw_base.files.pictures import open_picture
from nw_base.plural import plural
from nw_base.words import UpAxis
from nw_scenes.capture_file import first_problem
from nw_scenes.scene import Vector
from nw_twin.align.alignment import AlignOptions, KnownLength, check_inside, words_of
from nw_twin.align.positions import gps_positions
from nw_twin.align.tags import detector
from nw_twin.calibrate.photographs import DAMAGE, Footage, upright_size

FACTS_FILE = "known.json"
_FIX = "calibrate again: `nw-eval twin calibrate`"
_MOST_BYTES = 64 * 2**20
_UPS: Mapping[tuple[float, ...], UpAxis] = {(0.0, 1.0, 0.0): "+y", (0.0, 0.0, 1.0): "+z"}
_LOOKED_AT = 8
"""Photographs in which tags are looked for."""
_SIDE = 1600
"""Pixels of their longer side, at most."""
_GPS = 5.0
"""Metres that a phone's GPS errs by."""
_FAR = 30.0
"""Metres between photographs from which on that is good for a scale."""
GIVE = (
    "--tag-edge METRES of a printed tag36h11 in view, --camera-height METRES, or --length A B "
    "METRES between two points of photographs (IMG_1.jpg:412,310)"
)


def later(scene: Path) -> str:
    """Return what to do about a scene that is not to scale."""
    return (
        f"`nw-eval twin place {scene} --length A B METRES` (or --camera-height, --tag-edge) writes "
        f"it in metres without building again, `nw-eval twin label {scene}` with two clicks"
    )


@dataclass(frozen=True, kw_only=True)
class SourceFacts:
    """What the files of a source say about scale and up.

    Attributes:
        kind: of the source, e.g. `photographs`.
        photographs: that there are.
        metric: whether its cameras are in metres.
        up: which way is up in the frame of its cameras; None if unknown.
        positions: where photographs were taken by GPS, metres east, north and up of the first one,
            by their names.
        looked_at: photographs in which tags were looked for; 0 where that could not be.
        tags: tags 36h11 that were seen, with the number of photographs that show each.
    """

    kind: str
    photographs: int = 0
    metric: bool = False
    up: UpAxis | None = None
    positions: Mapping[str, Vector]
    looked_at: int = 0
    tags: Mapping[int, int]

    def completed(self, options: AlignOptions, names: Iterable[str]) -> AlignOptions:
        """Return options with what the source says of placed photographs, where they say nothing.

        Args:
            options: of somebody, which count first.
            names: of the photographs that were placed.
        """
        options = replace(options, metric=options.metric or self.metric, up=options.up or self.up)
        gps = {name: self.positions[name] for name in names if name in self.positions}
        # Where they lie too near together for a scale they are compared with others.
        if options.positions or len(gps) < 3 or _span(gps) < _GPS:
            return options
        return replace(options, positions=gps, positions_up="+z", positions_error=_GPS)


def facts_of_source(footage: Footage, options: AlignOptions) -> SourceFacts:
    """Look at a source, a few seconds at most.

    Raises:
        UsageError: a point of a length is in no photograph of the source.
        PrerequisiteError: tags are asked for, and what finds them is not installed.
    """
    paths = {one.name: one.path for one in footage.files if one.path is not None}
    lenses = {} if footage.cameras is None else footage.cameras.by_name

    def size_of(name: str) -> tuple[int, int] | None:
        placed = lenses.get(name)
        return upright_size(paths[name], None if placed is None else placed.lens)

    check_points(options.lengths, paths, size_of)
    positions = {} if footage.is_film else gps_positions(paths)
    looked_at, tags = _tags(paths, options)
    return SourceFacts(
        kind=footage.kind,
        photographs=len(footage.files),
        metric=footage.metric,
        up=None if footage.up is None else _UPS[footage.up],
        positions=positions,
        looked_at=looked_at,
        tags=tags,
    )


def check_points(
    lengths: Iterable[KnownLength],
    names: Iterable[str],
    size_of: Callable[[str], tuple[int, int] | None],
) -> None:
    """Check that the points of lengths are in photographs that there are.

    Args:
        lengths: of somebody.
        names: of the photographs.
        size_of: gives width and height of one; None where it cannot be read.

    Raises:
        UsageError: one is not.
    """
    known = set(names)
    for length in lengths:
        for end in (length.first, length.second):
            for name, pixel in end.items() if isinstance(end, Mapping) else ():
                if name not in known:
                    raise UsageError(
                        f"--length {words_of(end)}: there is no photograph {name!r}",
                        fix=nearest(name, sorted(known)),
                    )
                if (size := size_of(name)) is not None:
                    check_inside(name, pixel, size)


def _tags(paths: Mapping[str, Path], options: AlignOptions) -> tuple[int, dict[int, int]]:
    try:
        detect = detector()
    except PrerequisiteError:
        if options.tag_edge is not None:
            raise
        return 0, {}
    names = list(paths)
    tags: dict[int, int] = {}
    looked_at = 0
    for place in np.unique(np.linspace(0, len(names) - 1, min(_LOOKED_AT, len(names))).astype(int)):
        try:
            with open_picture(paths[names[place]]) as image:
                image.draft("L", (_SIDE, _SIDE))
                grey = image.convert("L")
        except (*DAMAGE, SceneError):
            continue  # Whoever takes it in says what is wrong with it.
        grey.thumbnail((_SIDE, _SIDE), Image.Resampling.BILINEAR)
        looked_at += 1
        for number in {number for number, _ in detect(np.ascontiguousarray(grey))}:
            tags[number] = tags.get(number, 0) + 1
    return looked_at, dict(sorted(tags.items()))


def scale_lines(facts: SourceFacts | None, options: AlignOptions, scene: Path) -> list[str]:
    """Return what will give the scale, or that nothing will and how to give one, for people."""
    given: list[str] = []
    could: list[str] = []
    seen = "no AprilTag is in the photographs that were looked at"
    if facts is not None and facts.tags:
        number, count = max(facts.tags.items(), key=lambda one: one[1])
        seen = f"tag {number} is in {count} of the {facts.looked_at} photographs looked at"
    if options.tag_edge is not None:
        given.append(f"--tag-edge {options.tag_edge:g}: {seen}")
    elif facts is not None and facts.tags:
        could.append(f"{seen}: measure its black border's outer edge and give --tag-edge METRES")
    given += [
        f"--length: {one.metres:g} m between {words_of(one.first)} and {words_of(one.second)}"
        for one in options.lengths
    ]
    if options.camera_height is not None:
        given.append(f"--camera-height {options.camera_height:g}, if a floor is found below")
    if options.metric or (facts is not None and facts.metric):
        what = "--metric" if options.metric or facts is None else f"the cameras of {facts.kind}"
        given.append(f"{what}: poses in metres")
    elif facts is not None and facts.kind not in {"photographs", "video"}:
        could.append(f"--metric says that the cameras of {facts.kind} are in metres, if they are")
    if facts is not None and facts.positions:
        span = _span(facts.positions)
        where = (
            f"GPS in {len(facts.positions)} of {plural(facts.photographs, 'photograph')}, "
            f"over {span:.0f} m"
        )
        (given if span >= _FAR else could).append(
            f"{where}: good to about {_GPS / max(span, 1.0):.0%}"
            if span >= _FAR
            else f"{where}: too near together for a scale, GPS errs by {_GPS:g} m"
        )
    if given:
        return [f"scale: by {line}" for line in given] + [f"scale: {line}" for line in could]
    return [
        "scale: nothing gives one: no tag, GPS or metric poses were found, and no option gives one"
        if not could
        else "scale: nothing gives one yet",
        *(f"scale: {line}" for line in could),
        f"scale: the scene will be in a unit of its own. Give one now, {GIVE}",
        f"scale: or later: {later(scene)}",
    ]


def _span(positions: Mapping[str, Vector]) -> float:
    """Return how far apart positions lie over the ground, metres."""
    return float(np.ptp(np.array(list(positions.values()))[:, :2], axis=0).max())


class _Facts(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    version: int = Field(alias="nw-known", default=1, ge=1, le=1)
    kind: str
    photographs: Annotated[int, Field(ge=0)]
    metric: bool
    up: UpAxis | None
    positions: dict[str, tuple[FiniteFloat, FiniteFloat, FiniteFloat]]
    looked_at: Annotated[int, Field(ge=0)]
    tags: dict[int, int]


def write_facts(facts: SourceFacts, folder: Path) -> None:
    """Write them into a capture's folder.

    Raises:
        StoreError: they cannot be written.
    """
    with atomic_path(folder / FACTS_FILE) as temporary:
        text = json.dumps({"nw-known": 1, **asdict(facts)}, indent=1, ensure_ascii=False)
        temporary.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")


def read_facts(folder: Path) -> SourceFacts | None:
    """Return what was known of a capture's source; None if it was not recorded.

    Raises:
        SceneError: the file is damaged.
    """
    path = folder / FACTS_FILE
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise SceneError(f"{path} is larger than {_MOST_BYTES} bytes", fix=_FIX)
        read = _Facts.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise SceneError(f"{path} cannot be read: {first_problem(error)}", fix=_FIX) from None
    return SourceFacts(**read.model_dump(exclude={"version"}))
