"""How much of the logs' evidence a page has room for."""

from __future__ import annotations

from collections.abc import Mapping

from nw_eval.plural import plural
from nw_eval.reporting.html.evidence import (
    CLIP_BYTES,
    PICTURE_BYTES,
    Clip,
    LogEvidence,
    PlacePicture,
)


def clips_that_fit(evidence: LogEvidence) -> tuple[dict[str, Clip], tuple[str, ...]]:
    """Return clips by trial, the first ones of `evidence`, and what was left out in words."""
    kept: dict[str, Clip] = {}
    room = CLIP_BYTES
    for clip in evidence.clips:
        room -= len(clip.data) + len(clip.still or b"")
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
    return kept, _left_out(len(pictured) - len(kept), "picture of a place", "pictures of places")


def _left_out(count: int, noun: str, several: str | None = None) -> tuple[str, ...]:
    return (f"{plural(count, noun, several)} left out: the page is full.",) if count else ()
