"""Printed tags of known edge: found in the pictures, placed by all shots that show them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PrerequisiteError
from nw_eval.plural import plural
from nw_eval.twin.align.alignment import TagFamily
from nw_eval.twin.align.triangulate import triangulate
from nw_eval.twin.capture import Capture, read_picture

Values = NDArray[np.float64]
Detect = Callable[[NDArray[np.uint8]], list[tuple[int, Values]]]

_ARUCO = {"aruco_4x4_50": "DICT_4X4_50", "aruco_5x5_100": "DICT_5X5_100"}
_SURE = 25.0
"""Least margin of a tag's black over its white, of 255."""
_UNEVEN = 0.05
"""Largest relative difference between the edges of a tag that was placed well."""


@dataclass(frozen=True, kw_only=True)
class PlacedTag:
    """A tag in the capture's frame.

    Attributes:
        number: which tag it is.
        edge: mean of its four edges, in the capture's unit.
        uneven: largest difference of an edge from the mean, relative.
        shots: that agree on it.
        pixels: root mean square of what they are off.
    """

    number: int
    edge: float
    uneven: float
    shots: int
    pixels: float


def find_tags(
    capture: Capture, folder: Path, family: TagFamily, say: Callable[[str], None]
) -> dict[int, list[tuple[int, Values]]]:
    """Return for each tag the shots that show it and its corners there, (4, 2) pixels.

    Corners are those of the black border's outer edge, to a fraction of a pixel.

    Raises:
        PrerequisiteError: what finds tags is not installed.
        SceneError: a picture cannot be read.
    """
    detect = detector(family)
    found: dict[int, list[tuple[int, Values]]] = {}
    for place, shot in enumerate(capture.shots):
        red, green, blue = np.moveaxis(read_picture(shot, folder).astype(np.float32), 2, 0)
        grey = np.ascontiguousarray(0.299 * red + 0.587 * green + 0.114 * blue).astype(np.uint8)
        sightings = detect(grey)
        numbers = [number for number, _ in sightings]
        for number, corners in sightings:
            if numbers.count(number) == 1:  # Two of the same in one picture cannot be told apart.
                found.setdefault(number, []).append((place, corners))
    for number, seen in sorted(found.items()):
        say(f"tag {number} is in {plural(len(seen), 'picture')}")
    return dict(sorted(found.items()))


def place_tags(
    capture: Capture, found: dict[int, list[tuple[int, Values]]], *, tolerance: float = 2.0
) -> list[PlacedTag]:
    """Return the tags that two shots or more agree on, and that came out square.

    Args:
        capture: whose shots they are.
        found: what `find_tags` found.
        tolerance: how far off a shot may be at any corner, pixels.
    """
    placed: list[PlacedTag] = []
    for number, seen in found.items():
        cameras = [capture.shots[place].camera for place, _ in seen]
        answer = triangulate(cameras, np.array([c for _, c in seen]), tolerance=tolerance)
        if answer is None:
            continue
        corners = answer.points
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        uneven = float(np.abs(edges / edges.mean() - 1.0).max())
        if uneven <= _UNEVEN:
            placed.append(
                PlacedTag(
                    number=number,
                    edge=float(edges.mean()),
                    uneven=uneven,
                    shots=int(answer.used.sum()),
                    pixels=answer.pixels,
                )
            )
    return placed


def detector(family: TagFamily) -> Detect:
    """Return what finds tags in a grey picture (H, W) uint8: numbers and corners (4, 2), pixels.

    Raises:
        PrerequisiteError: what finds tags is not installed.
    """
    return _aruco(_ARUCO[family]) if family in _ARUCO else _apriltag(family)


def _apriltag(family: str) -> Detect:
    try:
        from pupil_apriltags import Detector
    except ImportError:
        raise PrerequisiteError(
            "finding tags needs pupil-apriltags, which is not installed",
            fix="pip install 'nw-eval[twin]'",
        ) from None

    class LastingDetector(Detector):
        """Lives on: the library's own end frees its families first, and crashes now and then."""

        def __del__(self) -> None:
            pass

    detector: Any = LastingDetector(families=family, nthreads=1, quad_decimate=1.0, refine_edges=1)

    def detect(grey: NDArray[np.uint8]) -> list[tuple[int, Values]]:
        return [
            (int(tag.tag_id), np.asarray(tag.corners, dtype=np.float64))
            for tag in detector.detect(grey)
            if tag.hamming <= 1 and tag.decision_margin >= _SURE
        ]

    return detect


def _aruco(name: str) -> Detect:
    try:
        import cv2
    except ImportError:
        raise PrerequisiteError(
            "finding markers needs OpenCV, which is not installed",
            fix="pip install 'nw-eval[twin]'",
        ) from None
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    detector: Any = cv2.aruco.ArucoDetector(dictionary, parameters)

    def detect(grey: NDArray[np.uint8]) -> list[tuple[int, Values]]:
        corners, numbers, _ = detector.detectMarkers(grey)
        if numbers is None:
            return []
        # OpenCV has the centre of the first pixel at (0, 0).
        return [
            (int(number), np.asarray(four, dtype=np.float64).reshape(4, 2) + 0.5)
            for number, four in zip(np.ravel(numbers), corners, strict=True)
        ]

    return detect
