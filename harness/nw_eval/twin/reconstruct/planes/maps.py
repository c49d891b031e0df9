"""Depth maps with what is plain filled in: planes that several views agree on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from nw_eval.twin.reconstruct.depth.maps import DepthMap
from nw_eval.twin.reconstruct.kernels.agree import count_agreeing
from nw_eval.twin.reconstruct.kernels.planar import count_seen
from nw_eval.twin.reconstruct.options import DepthOptions
from nw_eval.twin.reconstruct.planes.hypotheses import SupposedPlane
from nw_eval.twin.reconstruct.planes.labels import Labels, labelled

_FARTHEST = 3.0
"""Times the typical depth: beyond, a pixel is broader than a voxel."""
_CONFIDENCE = 0.5
"""Of a plane that views agree on, at least."""
_CARVED = 1.0 / 3.0
"""Share of the views of a point that may look through it; one is forgiven."""


def planar_maps(
    maps: Sequence[DepthMap],
    near: Sequence[Sequence[int]],
    planes: Sequence[SupposedPlane],
    options: DepthOptions,
    say: Callable[[str], None],
    threads: int = 2,
) -> list[DepthMap]:
    """Return the maps with the planes that their pixels show, where views agree.

    A pixel keeps its plane if as many neighbours as `options.least_agreeing` show the same surface
    there, and of all views few look through it. What is of no plane stays as it was measured.

    Args:
        maps: as measured.
        near: numbers of the maps that each is compared with.
        planes: that they may show.
        options: of the depths.
        say: is told of progress.
        threads: maps at once, each with about 0.2 GB at 640 x 360; no result depends on them.
    """
    known = np.concatenate([each.depth[each.depth > 0] for each in maps])
    if not planes or len(known) == 0:
        return list(maps)
    farthest = _FARTHEST * float(np.median(known))

    def label(number: int) -> Labels:
        others = [maps[other] for other in near[number]]
        if not others:
            own = maps[number]
            return Labels(depth=own.depth, planar=np.zeros(own.view.size, dtype=bool))
        return labelled(maps[number], others, planes, farthest)

    found: list[Labels] = []
    with ThreadPoolExecutor(threads) as pool:
        for number, labels in enumerate(pool.map(label, range(len(maps)))):
            found.append(labels)
            say(f"planes of {maps[number].view.name}: {number + 1} of {len(maps)}")
        whole = pool.map(
            lambda number: _agreed(maps, near[number], found, number, options), range(len(maps))
        )
        return list(whole)


def _agreed(
    maps: Sequence[DepthMap],
    near: Sequence[int],
    found: Sequence[Labels],
    number: int,
    options: DepthOptions,
) -> DepthMap:
    own, labels = maps[number], found[number]
    size = own.view.size
    count, seen, through = (np.zeros(size, np.uint8) for _ in range(3))
    for other, each in enumerate(maps):
        if other == number:
            continue
        move, shift = own.view.to(each.view)
        if other in near:
            depth = found[other].depth
            count_agreeing(labels.depth, depth, move, shift, options.tolerance, count)
        count_seen(labels.depth, found[other].depth, move, shift, seen, through)
    few = through <= np.maximum(1.0, _CARVED * seen)
    planar = labels.planar & (count >= options.least_agreeing) & few
    depth = np.where(planar, labels.depth, np.where(labels.planar, 0.0, own.depth))
    confidence = np.where(planar, np.maximum(own.confidence, _CONFIDENCE), own.confidence)
    return DepthMap(
        view=own.view,
        depth=depth.astype(np.float32),
        confidence=np.where(depth > 0, confidence, 0.0).astype(np.float32),
    )
