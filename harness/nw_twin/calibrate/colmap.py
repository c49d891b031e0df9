"""Folders of COLMAP: a model, and the photographs that it was made of.

Models are read by own code, .bin or .txt: a damaged file makes the library's reader run without
end. Formats: https://colmap.github.io/format.html. Rigs and frames, which newer models have
besides, are not needed: images.* holds every camera's own pose.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import regular
from nw_twin.calibrate.photographs import Footage, found_in, in_order, with_masks
from nw_twin.calibrate.report import Say
from nw_twin.calibrate.solution import Placed, Solution, check_pose, inverse, rigid
from nw_twin.capture import MOST_DISTANT
from nw_twin.lens import Lens

_PLACES = ("sparse", "colmap/sparse", "dense/sparse", ".")

_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
_SIZES = dict(_MODELS.values())
_NO_POINT = 2**64 - 1
_MOST_BYTES = 4 * 2**30
_FIX = "export the model again, or give the photographs alone"
_UNDISTORT = "undistort it with `colmap image_undistorter`, or give the photographs alone"


def colmap_in(folder: Path, say: Say) -> Footage | None:
    """Return the cameras and photographs of a COLMAP folder; None for another folder.

    Its model lies in `sparse/0`, `sparse` or the folder itself; of several in `sparse`, the one of
    the most photographs is taken. Its photographs lie in `images`, or beside the model.

    Args:
        folder: that may be one.
        say: is told which of several models is taken.

    Raises:
        SceneError: the model is damaged, or holds no photograph.
    """
    place = next((model for name in _PLACES if (model := _model(folder / name, say))), None)
    if place is None:
        return None
    cameras = read_model(place)
    if not cameras.placed:
        raise SceneError(f"the COLMAP model in {place} holds no photograph", fix="map again")
    beside = [folder / "images", place / "images", folder]
    is_several = place.parent == folder and place.name.isdecimal()
    if place == folder or is_several:  # The path of a model itself, or of several.
        beside += [folder.parent / "images", folder.parent.parent / "images", folder.parent]
    names = [one.name for one in cameras.placed]
    # Names may begin with `images/`: where the most are found is what they are relative to.
    images = max((one for one in beside if one.is_dir()), key=lambda one: _there(one, names))
    files = [found_in(images, name.replace("\\", "/"), called=name) for name in names]
    files = with_masks(files, [images / "masks", images.parent / "masks"])
    return Footage(kind="colmap", files=in_order(files), cameras=cameras)


def _model(folder: Path, say: Say) -> Path | None:
    """Return where the model of a folder lies: in one of its numbered folders, or itself."""
    if not folder.is_dir():
        return None
    numbered = sorted(
        (one for one in folder.iterdir() if one.name.isdecimal() and has_model(one)),
        key=lambda one: int(one.name),
    )
    if not numbered:
        return folder if has_model(folder) else None
    counts = [image_count(one) for one in numbered]
    most = max(counts)
    best = numbered[counts.index(most)]
    if len(numbered) > 1:
        others = ", ".join(
            f"{one.name} has {count}" for one, count in zip(numbered, counts, strict=True)
        )
        say(
            f"{len(numbered)} models in {folder}: {best.name} is taken, which has the most "
            f"photographs ({others}); give {folder}/N for another"
        )
    return best


def _there(folder: Path, names: list[str]) -> int:
    files = (found_in(folder, name.replace("\\", "/")).path for name in names)
    return sum(1 for path in files if path is not None and path.is_file())


def has_model(folder: Path) -> bool:
    """Return whether a folder holds a model of COLMAP."""
    return _suffix(folder) is not None


def _suffix(folder: Path) -> str | None:
    for suffix in (".bin", ".txt"):
        if all((folder / (name + suffix)).is_file() for name in ("cameras", "images")):
            return suffix
    return None


def image_count(folder: Path) -> int:
    """Return how many photographs a model says that it holds; -1 if it cannot be read."""
    try:
        if _suffix(folder) == ".bin":
            with (folder / "images.bin").open("rb") as file:
                return int(struct.unpack("<Q", file.read(8))[0])
        return sum(1 for _ in _Text().images(_bytes(folder / "images.txt")))
    except (OSError, struct.error, ValueError, LookupError):
        return -1


def read_model(folder: Path) -> Solution:
    """Read a model.

    Raises:
        SceneError: the model is missing or damaged.
    """
    suffix = _suffix(folder)
    if suffix is None:
        raise SceneError(f"no cameras and images of COLMAP in {folder}", fix=_FIX)
    read = _Binary() if suffix == ".bin" else _Text()
    try:
        lenses = dict(read.cameras(_bytes(folder / f"cameras{suffix}")))
        for key, lens in lenses.items():
            _check_lens(lens, f"camera {key} of {folder / f'cameras{suffix}'}")
        images = list(read.images(_bytes(folder / f"images{suffix}")))
        path = folder / f"points3D{suffix}"
        points = dict(read.points(_bytes(path))) if path.is_file() else {}
        return _solution(folder, lenses, images, points)
    except (OSError, struct.error, ValueError, LookupError, TypeError, OverflowError) as error:
        raise SceneError(f"the COLMAP model in {folder} is damaged: {error}", fix=_FIX) from None


def _check_lens(lens: Lens, whose: str) -> None:
    """Check that a lens is one that a picture can be flattened by.

    Raises:
        SceneError: it is not.
    """
    size = _SIZES.get(lens.model)
    if size is None:
        raise SceneError(
            f"{whose} is of a model that is not known, {clean(lens.model, at_most=40)}",
            fix=_UNDISTORT,
        )
    if lens.model == "EQUIRECTANGULAR":
        raise SceneError(
            f"{whose} is EQUIRECTANGULAR: a panorama is not supported",
            fix="cut the panoramas into flat pictures, as COLMAP's panorama_sfm.py does",
        )
    if len(lens.params) != size:
        raise SceneError(
            f"{whose} is {lens.model}, which has {size} parameters, with {len(lens.params)}",
            fix=_FIX,
        )
    lens.check(whose)


def _bytes(path: Path) -> bytes:
    if regular(path).stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path.name} is larger than {_MOST_BYTES} bytes")
    return path.read_bytes()


def _solution(
    folder: Path,
    lenses: dict[int, Lens],
    images: list[tuple[Any, ...]],
    points: dict[int, tuple[Any, ...]],
) -> Solution:
    ids = np.array(sorted(points), dtype=np.uint64)
    placed: list[Placed] = []
    for name, quaternion, translation, camera, observed in images:
        seen = np.unique(observed[observed != np.uint64(_NO_POINT)])
        rows = np.searchsorted(ids, seen)
        known = rows < len(ids)
        known[known] = ids[rows[known]] == seen[known]
        whose = f"{clean(name, at_most=100)} of the COLMAP model in {folder}"
        T = rigid(pose_of(np.asarray(quaternion), np.asarray(translation), whose), whose)
        placed.append(
            Placed(
                name=name,
                lens=lenses[camera],
                T_world_camera=inverse(T),
                seen=rows[known].astype(np.int32),
            )
        )
    rows = [points[int(one)] for one in ids]
    if not (np.abs([(*row[0], row[2]) for row in rows]) <= MOST_DISTANT).all():
        raise ValueError(f"points are not finite, or beyond {MOST_DISTANT:g}")
    return Solution(
        placed=tuple(placed),
        points=np.array([row[0] for row in rows], dtype=np.float64).reshape(-1, 3),
        colours=np.array([row[1] for row in rows], dtype=np.uint8).reshape(-1, 3),
        errors=np.clip([row[2] for row in rows], 0, 1e6).astype(np.float32),  # -1: not known.
    )


def pose_of(wxyz: np.ndarray, translation: np.ndarray, whose: str) -> np.ndarray:
    """Return a pose (4, 4) of a quaternion (4,) and a translation (3,).

    Raises:
        SceneError: the quaternion is none, or the translation too large.
    """
    length = float(np.linalg.norm(wxyz)) if (np.abs(wxyz) < 2.0).all() else math.inf
    if not 0.9 < length < 1.1:
        raise SceneError(
            f"the pose of {whose} is invalid: its quaternion {wxyz.tolist()} has the length "
            f"{length:.3g}, not 1",
            fix=_FIX,
        )
    w, x, y, z = wxyz / length
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = translation
    check_pose(T, whose)
    return T


class _Binary:
    """Little-endian, each file beginning with a count."""

    @staticmethod
    def cameras(data: bytes) -> Iterator[tuple[int, Lens]]:
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            key, model, width, height = struct.unpack_from("<IiQQ", data, at)
            if model not in _MODELS:
                # How long it is is not known either, so that nothing behind it can be read.
                yield key, Lens(model=f"number {model}", width=width, height=height, params=())
                return
            name, size = _MODELS[model]
            params = struct.unpack_from(f"<{size}d", data, at + 24)
            at += 24 + 8 * size
            yield key, Lens(model=name, width=width, height=height, params=params)

    @staticmethod
    def images(data: bytes) -> Iterator[tuple[Any, ...]]:
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            pose = struct.unpack_from("<I7dI", data, at)
            end = data.index(b"\0", at + 64)
            name = data[at + 64 : end].decode("utf-8")
            (size,) = struct.unpack_from("<Q", data, end + 1)
            if size > len(data):
                raise ValueError("it is cut short")
            kind = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
            observed = np.frombuffer(data, kind, size, end + 9)["point"]
            at = end + 9 + kind.itemsize * size
            yield name, pose[1:5], pose[5:8], pose[8], observed

    @staticmethod
    def points(data: bytes) -> Iterator[tuple[int, tuple[Any, ...]]]:
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            key, x, y, z, r, g, b, error, length = struct.unpack_from("<Q3d3BdQ", data, at)
            at += 51 + 8 * length
            yield key, ((x, y, z), (r, g, b), error)


class _Text:
    """Lines of words; those that begin with # say nothing."""

    @staticmethod
    def _lines(data: bytes) -> Iterator[str]:
        for line in data.decode("utf-8").splitlines():
            if not line.startswith("#"):
                yield line

    def cameras(self, data: bytes) -> Iterator[tuple[int, Lens]]:
        for line in self._lines(data):
            words = line.split()
            if words:
                width, height = int(words[2]), int(words[3])
                params = tuple(map(float, words[4:]))
                yield (
                    int(words[0]),
                    Lens(model=words[1], width=width, height=height, params=params),
                )

    def images(self, data: bytes) -> Iterator[tuple[Any, ...]]:
        lines = self._lines(data)
        for line in lines:
            words = line.split(maxsplit=9)
            if not words:
                continue
            numbers = [float(word) for word in words[1:8]]
            # Every third word of the next line; -1 where no point was made.
            observed = [int(word) % 2**64 for word in next(lines, "").split()[2::3]]
            yield words[9], numbers[:4], numbers[4:], int(words[8]), np.array(observed, np.uint64)

    def points(self, data: bytes) -> Iterator[tuple[int, tuple[Any, ...]]]:
        for line in self._lines(data):
            words = line.split()
            if words:
                place = tuple(map(float, words[1:4]))
                yield int(words[0]), (place, tuple(map(int, words[4:7])), float(words[7]))
