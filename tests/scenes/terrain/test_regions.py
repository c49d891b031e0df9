"""Connected regions against a flood fill."""

from collections import deque

import numpy as np
import pytest

from nw_scenes.mending import label_regions


def flood(mask):
    seen = np.zeros(mask.shape, dtype=int)
    count = 0
    for start in zip(*np.nonzero(mask), strict=True):
        if seen[start]:
            continue
        count += 1
        seen[start] = count
        queue = deque([start])
        while queue:
            r, c = queue.popleft()
            for i in range(max(r - 1, 0), min(r + 2, mask.shape[0])):
                for j in range(max(c - 1, 0), min(c + 2, mask.shape[1])):
                    if mask[i, j] and not seen[i, j]:
                        seen[i, j] = count
                        queue.append((i, j))
    return seen, count


@pytest.mark.parametrize("seed", range(6))
def test_regions_are_those_of_a_flood_fill(seed):
    random = np.random.default_rng(seed)
    mask = random.uniform(size=(23, 31)) < random.uniform(0.1, 0.6)
    labels, count = label_regions(mask)
    truth, expected = flood(mask)
    assert count == expected
    assert ((labels > 0) == mask).all()
    pairs = {(a, b) for a, b in zip(labels[mask], truth[mask], strict=True)}
    assert len(pairs) == expected


def test_an_empty_mask_has_no_regions():
    assert label_regions(np.zeros((3, 4), dtype=bool))[1] == 0
