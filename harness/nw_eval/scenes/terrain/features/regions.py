"""Connected regions of a mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def label_regions(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """Return (R, C) labels from 1, 0 outside, and their number; diagonal neighbours connect.

    Runs of each row are joined with the runs that they touch in the row before.
    """
    labels = np.zeros(mask.shape, dtype=np.int32)
    parents: list[int] = [0]
    previous: list[tuple[int, int, int]] = []
    for row in range(mask.shape[0]):
        edges = np.flatnonzero(np.diff(mask[row].astype(np.int8), prepend=0, append=0))
        runs: list[tuple[int, int, int]] = []
        first = 0
        for start, stop in edges.reshape(-1, 2).tolist():
            name = 0
            while first < len(previous) and previous[first][1] < start:
                first += 1  # It ends before this run and all that follow.
            touching = first
            while touching < len(previous) and previous[touching][0] <= stop:
                root = _root(parents, previous[touching][2])
                touching += 1
                if name == 0:
                    name = root
                elif root != name:
                    low, high = min(root, name), max(root, name)
                    parents[high] = low
                    name = low
            if name == 0:
                name = len(parents)
                parents.append(name)
            labels[row, start:stop] = name
            runs.append((start, stop, name))
        previous = runs
    roots = np.array([_root(parents, name) for name in range(len(parents))])
    names, compact = np.unique(roots, return_inverse=True)
    return compact.astype(np.int32)[labels], len(names) - 1


def _root(parents: list[int], name: int) -> int:
    while parents[name] != name:
        parents[name] = parents[parents[name]]
        name = parents[name]
    return name
