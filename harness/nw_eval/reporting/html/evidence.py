"""What a page shows of trials' logs: where the robot walked, the scene from above, short clips.

Rows say what a trial came to, and the page is whole with them alone; logs may be deleted, were not
recorded, or cannot be read. Whoever reads logs hands what they hold over in these values. The page
looks up a trial's scene and outcome in its row, thins paths, and leaves out what its budget has no
room for, and says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural

CLIP_BYTES = 2_500_000
"""Bytes of all clips of a page together; base64 adds a third, and a page of 160 trials has 5 MB."""

PICTURE_BYTES = 600_000
"""Bytes of all pictures of places of a page together."""

ClipType = Literal["image/webp", "image/png", "image/gif"]
PictureType = Literal["image/webp", "image/png", "image/jpeg"]


@dataclass(frozen=True, kw_only=True)
class WalkedPath:
    """Where the trunk of one trial's robot went, in the scene's world frame."""

    trial_id: str
    points: NDArray[np.floating]
    """Shape (n, 2): x and y, metres, in the order of time; as dense as the log has them."""
    period: float = 0.1
    """Seconds between two points; the last one may come sooner."""
    contacts: tuple[float, ...] = ()
    """When each contact of head or trunk began, s."""


@dataclass(frozen=True, kw_only=True)
class PlacePicture:
    """A picture of a scene from straight above: x to the right, y up.

    One in greys is on a light ground: a dark page shows it inverted.
    """

    mime: PictureType
    data: bytes
    west: float
    """Of its edges, metres in the world frame: the least x; `east` is the greatest."""
    east: float
    south: float
    """Of its edges, metres in the world frame: the least y; `north` is the greatest."""
    north: float
    is_coloured: bool = False


@dataclass(frozen=True, kw_only=True)
class PlaceView:
    """A scene from above, as far as its logs show it."""

    scene: str
    waypoints: NDArray[np.floating]
    """Shape (k, 2): x and y, metres, in their order."""
    reach: float | None = None
    """Metres from a waypoint at which it counts as reached; None where that is not known."""
    outlines: tuple[NDArray[np.floating], ...] = ()
    """Closed polygons of what stands or is missing there, each of shape (n, 2), metres."""
    picture: PlacePicture | None = None
    note: str = ""
    """A sentence on what the view shows; empty where none is needed."""


@dataclass(frozen=True, kw_only=True)
class Film:
    """The last seconds of a trial from outside, as pictures that move, and the last one."""

    data: bytes
    """An animated WebP."""
    still: bytes
    """A WebP."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""


@dataclass(frozen=True, kw_only=True)
class Clip:
    """What a trial's policy saw up to its end, as a picture that moves by itself or stands."""

    trial_id: str
    mime: ClipType
    data: bytes
    """Of one whole file, such as an animated WebP."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    still: bytes | None = None
    """A WebP of its last frame, for paper and for whoever wants nothing to move; may be absent."""
    seconds: float
    """That it shows, simulated."""
    caption: str
    """One sentence on what is seen; may be a third party's text."""
    span: str = ""
    """The sentence without what is seen, for a page that leaves `data` out."""
    is_of_policy: bool = True
    """Whether the policy saw it; else the robot's camera did, for people."""
    outside: Film | None = None
    """The same seconds from behind the robot."""
    baseline: Film | None = None
    """The baseline's policy from the same initial state, from behind the robot, too."""
    baseline_caption: str = ""
    """What the baseline's policy does there; empty without `baseline`."""

    @property
    def films(self) -> tuple[tuple[str, Film | Clip], ...]:
        """What a page shows side by side, each with its name.

        A camera that no policy sees through is left out where both policies are shown.
        """
        outside = [
            (name, film)
            for name, film in (("candidate", self.outside), ("baseline", self.baseline))
            if film is not None
        ]
        if len(outside) == 2 and not self.is_of_policy:
            return tuple(outside)
        name = "what the policy saw" if self.is_of_policy else "the robot's camera"
        return (*outside, (name, self))

    @property
    def said(self) -> str:
        """The sentence below these films."""
        is_shown = any(film is self for _, film in self.films)
        words = self.caption if is_shown or not self.span else self.span
        return f"{words} Beside it: {self.baseline_caption}." if self.baseline else words


@dataclass(frozen=True, kw_only=True)
class LogEvidence:
    """All of it, in any order; at most one path and one clip of a trial, one place of a scene."""

    paths: tuple[WalkedPath, ...] = ()
    places: tuple[PlaceView, ...] = ()
    clips: tuple[Clip, ...] = ()
    """The worst trial first; what exceeds `CLIP_BYTES` is left out from the end."""
    remarks: tuple[str, ...] = ()
    """Sentences on what could not be shown and why; may hold a third party's text."""
    of_paths: str = ""
    """Of which trials paths are drawn; empty if of all."""


NO_EVIDENCE = LogEvidence()
"""What a run without logs has to show beside its rows."""


def clips_that_fit(evidence: LogEvidence) -> tuple[dict[str, Clip], tuple[str, ...]]:
    """Return clips by trial, the first ones of `evidence`, and what was left out in words."""
    kept: dict[str, Clip] = {}
    room = CLIP_BYTES
    for clip in evidence.clips:
        room -= len(clip.data) + len(clip.still or b"")
        for film in (clip.outside, clip.baseline):
            room -= 0 if film is None else len(film.data) + len(film.still)
        if room < 0:
            break
        kept[clip.trial_id] = clip
    return kept, _left_out(len(evidence.clips) - len(kept), "clip")


def pictures_that_fit(evidence: LogEvidence) -> tuple[Mapping[str, PlacePicture], tuple[str, ...]]:
    """Return pictures by scene, and what was left out in words; the smallest come first."""
    pictured = {each.scene: each.picture for each in evidence.places if each.picture is not None}
    kept: dict[str, PlacePicture] = {}
    room = PICTURE_BYTES
    for scene, picture in sorted(pictured.items(), key=lambda item: (len(item[1].data), item[0])):
        room -= len(picture.data)
        if room >= 0:
            kept[scene] = picture
    return kept, _left_out(len(pictured) - len(kept), "picture of a scene", "pictures of scenes")


def _left_out(count: int, noun: str, several: str | None = None) -> tuple[str, ...]:
    return (f"{plural(count, noun, several)} left out: the page is full.",) if count else ()
