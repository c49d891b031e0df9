"""The compiled loops of matching: for each feature the two most similar of another picture.

Among all of its features, or among those that a motion of the camera allows. A descriptor of SIFT
is 128 whole numbers of 8 bits and of length 512, so that products of two are whole numbers below
2^24, exact in single precision: no result depends on how a machine adds them.

None of it knows of files.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel


@kernel
def two_best(products: Any, first_row: int, count: int, other: int, largest: Any) -> None:
    """Take blocks of products into account: the largest two of each row and of each column.

    Args:
        products: (A, B, R, C) float32: of A times R descriptors of one picture with B times C of
            the other, in their order.
        first_row: number of the first of them.
        count: of the one picture's descriptors; what goes beyond is not there.
        other: of the other's, as above.
        largest: in and out: (2, N) float32, the largest product of each row, then of each column;
            (2, N) float32, the second largest; (2, N) int32, the column, then the row of the
            largest, of equals the first.
    """
    best, second, place = largest
    blocks, across, rows, columns = products.shape
    for a in range(blocks):
        for r in range(rows):
            row = first_row + a * rows + r
            if row >= count:
                return
            high, low, at = np.float32(-1.0), np.float32(-1.0), np.int32(-1)
            for b in range(across):
                for c in range(min(columns, other - b * columns)):
                    column = b * columns + c
                    value = products[a, b, r, c]
                    if value > low:
                        if value > high:
                            low, high, at = high, value, np.int32(column)
                        else:
                            low = value
                    if value > second[1, column]:
                        if value > best[1, column]:
                            second[1, column] = best[1, column]
                            best[1, column], place[1, column] = value, np.int32(row)
                        else:
                            second[1, column] = value
            best[0, row], second[0, row], place[0, row] = high, low, at


@inlined
def _take(r: int, k: int, one: Any, other: Any, largest: Any) -> None:
    best, second, place = largest
    total = np.int32(0)
    for i in range(one.shape[1]):
        total += np.int32(one[r, i]) * np.int32(other[k, i])
    value = np.float32(total)
    if value > best[0, r]:
        second[0, r], best[0, r], place[0, r] = best[0, r], value, np.int32(k)
    elif value > second[0, r]:
        second[0, r] = value
    if value > best[1, k]:
        second[1, k], best[1, k], place[1, k] = best[1, k], value, np.int32(r)
    elif value > second[1, k]:
        second[1, k] = value


@kernel
def two_best_along(
    lines: Any, points: Any, widths: Any, limit: float, one: Any, other: Any, largest: Any
) -> None:
    """As `two_best`, of pairs near each other's epipolar line alone.

    A pair counts if its Sampson error is at most the limit (Hartley and Zisserman, Multiple View
    Geometry, 2004, equation 11.9).

    Args:
        lines: (N, 4) float64, F x of each feature of one picture, and its first two squared, added.
        points: (M, 2) float64, features of the other picture.
        widths: (M,) float64, of F^T x' of each of those the first two squared, added.
        limit: of the Sampson error, squared.
        one: (N, 128) uint8, descriptors.
        other: (M, 128) uint8.
        largest: as for `two_best`.
    """
    for r in range(lines.shape[0]):
        a, b, c, width = lines[r, 0], lines[r, 1], lines[r, 2], lines[r, 3]
        for k in range(points.shape[0]):
            off = a * points[k, 0] + b * points[k, 1] + c
            if off * off <= limit * (width + widths[k]):
                _take(r, k, one, other, largest)


@kernel
def two_best_near(
    targets: Any, points: Any, limit: float, one: Any, other: Any, largest: Any
) -> None:
    """As `two_best`, of pairs alone that lie where a homography puts them.

    Args:
        targets: (N, 2) float64, where it puts each feature of one picture in the other.
        points: (M, 2) float64, features of the other picture.
        limit: of the distance, squared.
        one: (N, 128) uint8, descriptors.
        other: (M, 128) uint8.
        largest: as for `two_best`.
    """
    for r in range(targets.shape[0]):
        x, y = targets[r, 0], targets[r, 1]
        for k in range(points.shape[0]):
            dx, dy = points[k, 0] - x, points[k, 1] - y
            if dx * dx + dy * dy <= limit:
                _take(r, k, one, other, largest)
