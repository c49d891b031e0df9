"""Features of photographs and which of them match, in a database of COLMAP.

COLMAP finds the features and estimates the motion between two photographs. Which features match is
found here: a product of two descriptors is a whole number that a matrix product gives exactly
(see `match_kernels`), in a sixteenth of the processor time of COLMAP's matchers without a GPU
(pycolmap 4.2.1), and the same for any number of threads.

Features and matches are kept in a file as they come, by digests of all that they depend on: a
calibration that was cut off goes on from there.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.pictures import open_picture
from nw_twin.calibrate.kept import Kept
from nw_twin.calibrate.photographs import Photograph
from nw_twin.calibrate.report import Pace, Say
from nw_twin.lens import Lens
from nw_twin.options import CalibrateOptions
from nw_twin.packages import quiet

_GUESS = 1.2
"""Focal length in longer sides, as COLMAP has it where nothing is known."""
_FAINT = 0.003
"""Contrast of a feature, at least; COLMAP's own 0.0067 finds too few on plain floors. The shape of
each is measured too: on a street, a table and a built-in course that gave 10 to 30 % more verified
matches for less than twice the time. To average descriptors over ten sizes (COLMAP's
`domain_size_pooling`) took three times as long again, and gave no more: 3 % more on the street, a
fifth fewer on the table."""

_RATIO, _FAR = 0.8, 0.7
"""Of the angle to the best match to that to the second best, and the angle itself, radians, at
most: COLMAP's own."""
_UNIT = 1.0 / 512**2
"""Of a product of two descriptors: each has length 512."""
_ROWS, _COLUMNS, _AT_ONCE = 32, 64, 8
"""Of a matrix product, and products that are looked at before the next ones. So small a one is
worked on by one thread: those of OpenBLAS that wait for others took three times the processor time
on a busy machine."""

ALL = 30
"""Photographs of which all pairs are compared."""
_OVERLAP = 5
"""Neighbours on one side that each photograph of a sequence is compared with."""
_ALIKE = 12
"""Most similar photographs that each is compared with."""
_LARGEST = 400
"""Features by which photographs are similar: the largest ones, as other distances show them too."""
_HINT = 4
"""Matches of the largest features without which two photographs are not similar. Four is Wu's, of
the hundred largest ("Towards Linear-time Incremental Structure from Motion", 2013)."""

_FORMAT = 1
"""Of what is kept; changes with what is made of the same inputs."""

Groups = list[tuple[Lens | None, list[Photograph]]]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True, kw_only=True)
class Matches:
    """A database of COLMAP with features and verified matches, and its contents.

    Attributes:
        database: its file.
        pictures: folder of the pictures that it names.
        features: of each picture, by file name.
        inliers: matches of two pictures, by their file names, that one motion of a camera explains.
        pairs: that were compared.
        turned: pairs that a mere turn of the camera explains as well, or one flat surface.
    """

    database: Path
    pictures: Path
    features: dict[str, int]
    inliers: dict[tuple[str, str], int]
    pairs: int
    turned: int = 0


@dataclass(frozen=True)
class Features:
    """Features of one picture.

    Attributes:
        points: (N, 4) float32: x, y, scale, orientation; the first pixel's centre is at (0.5, 0.5).
        descriptors: (N, 128) uint8.
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def largest(self) -> NDArray[np.float32]:
        """Return the descriptors (K, 128) of the largest features."""
        rows = np.argsort(-self.points[:, 2], kind="stable")[:_LARGEST]
        return self.descriptors[rows].astype(np.float32)


@dataclass(frozen=True)
class _Geometry:
    """What one motion of a camera explains of two pictures.

    Attributes:
        config: COLMAP's number of the kind of motion; 0 = none.
        models: (3, 3, 3) float64: E, F and H; NaN where there is none.
        matches: (N, 2) uint32, numbers of features.
    """

    config: int
    models: NDArray[np.float64]
    matches: NDArray[np.uint32]


def match(
    photographs: Sequence[Photograph],
    lenses: Sequence[Lens | None],
    matching: str,
    working: Path,
    options: CalibrateOptions,
    say: Say,
    kept: Kept | None = None,
) -> Matches:
    """Find features and compare pairs of photographs.

    The result does not depend on threads: each picture and each pair is worked on by one, with
    random numbers of its own.

    Args:
        photographs: in the working folder's `pictures`.
        lenses: as they are known, for each photograph; None where they are to be found.
        matching: `sequential`, `retrieval` or `exhaustive`: see `CalibrateOptions`.
        working: gets `matches.db`.
        options: of the calibration.
        say: is given lines of progress.
        kept: by an earlier calibration of them that was cut off, and gets what is found.

    Raises:
        SceneError: COLMAP fails.
        StoreError: features or matches cannot be written.
    """
    with quiet() as pycolmap:
        try:
            task = _Matching(pycolmap, photographs, lenses, working, options, say, kept)
            task.enter()
            task.extract()
            pairs = task.pairs(matching)
            task.compare(pairs)
            return task.write(len(pairs))
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            raise SceneError(
                f"COLMAP could not compare the photographs: {error}",
                fix="look at the photographs; fewer features (--features) or smaller pictures "
                "(--side) need less memory",
            ) from None


def every_pair(count: int) -> list[tuple[int, int]]:
    """Return all pairs (i, j), i < j < count, sorted."""
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def pairs_of(count: int, *, in_sequence: bool) -> list[tuple[int, int]]:
    """Return pairs (i, j), i < j, sorted, that are compared whatever the pictures show.

    Args:
        count: of photographs.
        in_sequence: whether neighbours in number are neighbours in space: then each is compared
            with the next five and those 8, 16, 32, ... further; else none is. Of up to thirty all
            are compared.
    """
    if count <= ALL:
        return every_pair(count)
    if not in_sequence:
        return []
    steps = [*range(1, _OVERLAP + 1), *(2**k for k in range(3, count.bit_length()))]
    return sorted((i, i + step) for i in range(count) for step in steps if i + step < count)


def most_alike(scores: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Return pairs (i, j), i < j: each photograph with those that are most similar to it.

    Args:
        scores: (N, N), symmetric; of equals the first in order.
    """
    pairs: set[tuple[int, int]] = set()
    for i, row in enumerate(scores):
        best = [j for j in np.argsort(-row, kind="stable").tolist() if j != i and row[j] >= _HINT]
        pairs |= {(min(i, j), max(i, j)) for j in best[:_ALIKE]}
    return pairs


def nearest(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return which descriptors match: (K, 2), sorted.

    Those of two pictures do that are each other's nearest, and much nearer than the second nearest
    is, from both sides.

    Args:
        one: (N, 128), whole numbers.
        other: (M, 128), whole numbers.
    """
    from nw_twin.calibrate.match_kernels import two_best

    best, size = _Best.of(len(one), len(other)), len(one)
    across = np.ascontiguousarray(_in_blocks(other, _COLUMNS).transpose(0, 2, 1))
    blocks = _in_blocks(one, _ROWS)
    for first in range(0, len(blocks), _AT_ONCE):
        products = np.matmul(blocks[first : first + _AT_ONCE, None], across[None])
        two_best(products, first * _ROWS, size, len(other), best.arrays)
    return best.mutual()


def _in_blocks(descriptors: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Return descriptors (B, rows, 128); zeros after the last."""
    more = -len(descriptors) % rows
    return np.pad(descriptors, ((0, more), (0, 0))).reshape(-1, rows, descriptors.shape[1])


@dataclass(frozen=True)
class _Best:
    """The two most similar of each feature of two pictures, as `match_kernels` has them."""

    arrays: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]
    count: int
    other: int

    @classmethod
    def of(cls, count: int, other: int) -> _Best:
        shape = 2, max(count, other)
        least = np.full(shape, -1.0, np.float32)
        return cls((least, least.copy(), np.full(shape, -1, np.int32)), count, other)

    def mutual(self) -> NDArray[np.uint32]:
        """Return the pairs (K, 2) of features that are each other's best, and clearly so."""
        best, second, place = self.arrays
        near, next_ = (np.arccos(np.clip(v.astype(float) * _UNIT, 0, 1)) for v in (best, second))
        good = (place >= 0) & (near <= _FAR) & (near < _RATIO * next_)
        rows = np.flatnonzero(good[0, : self.count])
        columns = place[0, rows]
        rows_back = np.where(good[1, columns], place[1, columns], -1)
        both = rows_back == rows
        return np.column_stack([rows[both], columns[both]]).astype(np.uint32)


class _Matching:
    """A database of COLMAP in a working folder, and what is entered into it."""

    def __init__(
        self,
        pycolmap: Any,
        photographs: Sequence[Photograph],
        lenses: Sequence[Lens | None],
        working: Path,
        options: CalibrateOptions,
        say: Say,
        kept: Kept | None,
    ) -> None:
        self._colmap, self._options, self._say, self._kept = pycolmap, options, say, kept
        self._photographs, self._lenses, self._working = photographs, lenses, working
        self._database, self._pictures = working / "matches.db", photographs[0].path.parent
        # Photographs share a camera: its lens if it is known, else by size and EXIF focal length.
        groups: dict[Any, tuple[Lens | None, list[Photograph]]] = {}
        for one, lens in zip(photographs, lenses, strict=True):
            focal = None if one.focal is None else round(one.focal, 1)
            key = lens or (one.width, one.height, focal)
            groups.setdefault(key, (lens, []))[1].append(one)
        self._groups: Groups = list(groups.values())
        self._features: list[Features] = []
        self._keys: list[bytes] = []
        self._geometries: dict[tuple[int, int], _Geometry] = {}
        self._verification = pycolmap.TwoViewGeometryOptions()
        self._verification.ransac.random_seed = options.seed

    def enter(self) -> None:
        """Enter pictures and their cameras."""
        self._colmap.Database.open(self._database).close()
        for lens, members in self._groups:
            self._colmap.import_images(
                self._database,
                self._pictures,
                camera_mode=self._colmap.CameraMode.SINGLE,
                image_names=[one.file for one in members],
                options=self._reader(lens, members[0]),
            )
        self._forget()
        with closing(self._colmap.Database.open(self._database)) as opened:
            cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
            self._images = {image.name: image.image_id for image in opened.read_all_images()}
            used = {image.name: image.camera_id for image in opened.read_all_images()}
        self._cameras = [cameras[used[one.file]] for one in self._photographs]

    def extract(self) -> None:
        """Find features."""
        pycolmap, own = self._colmap, threading.local()
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads, extraction.use_gpu = 1, False
        extraction.sift.max_num_features = self._options.features
        extraction.sift.peak_threshold = _FAINT
        extraction.sift.estimate_affine_shape = True
        facts = [_FORMAT, pycolmap.__version__, self._options.side, str(extraction.sift.todict())]
        self._keys = [
            _key(facts, _digest(one.path), _digest(one.mask)) for one in self._photographs
        ]
        by_key = {key: self._kept and _features_in(self._kept.get(key)) for key in self._keys}
        missing = [n for n, key in enumerate(self._keys) if by_key[key] is None]

        def work(number: int) -> Features:
            if not hasattr(own, "extractor"):
                own.extractor = pycolmap.FeatureExtractor.create(extraction, pycolmap.Device.cpu)
            return self._extracted(own.extractor, self._photographs[number])

        def take(number: int, features: Features) -> None:
            by_key[self._keys[number]] = features
            if self._kept is not None:
                content = features.points.tobytes() + features.descriptors.tobytes()
                self._kept.put(self._keys[number], content)

        self._share_out("features found", work, missing, take, len(self._keys))
        self._features = [features for key in self._keys if (features := by_key[key]) is not None]

    def _extracted(self, extractor: Any, one: Photograph) -> Features:
        bitmap = self._colmap.Bitmap.read(one.path, as_rgb=False)
        if bitmap is None:
            raise RuntimeError(f"{one.name} cannot be read")
        width, height = bitmap.width, bitmap.height
        scale = min(1.0, self._options.side / max(width, height))
        size = max(1, round(width * scale)), max(1, round(height * scale))
        if scale < 1:
            bitmap.rescale(*size)
        keypoints, descriptors = extractor.extract(bitmap)
        points = self._colmap.keypoints_to_matrix(keypoints).astype(np.float32).reshape(-1, 4)
        points[:, :3] *= np.array([width / size[0], height / size[1], width / size[0]], np.float32)
        values = descriptors.data.astype(np.uint8).reshape(-1, 128)
        if one.mask is not None:
            with open_picture(one.mask) as image:
                mask = np.asarray(image)
            x, y = points[:, :2].astype(int).T
            shown = mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)] > 0
            points, values = points[shown], values[shown]
        return Features(np.ascontiguousarray(points), np.ascontiguousarray(values))

    def pairs(self, matching: str) -> list[tuple[int, int]]:
        """Return which photographs are compared: (i, j), i < j, sorted."""
        count = len(self._photographs)
        if matching == "exhaustive":
            return every_pair(count)
        pairs = pairs_of(count, in_sequence=matching == "sequential")
        return pairs if count <= ALL else sorted({*pairs, *most_alike(self._scores())})

    def _scores(self) -> NDArray[np.int64]:
        """Return matches of the largest features of each two photographs (N, N)."""
        largest = [one.largest() for one in self._features]
        scores = np.zeros((len(largest), len(largest)), np.int64)

        def work(i: int) -> list[int]:
            return [len(nearest(largest[i], other)) for other in largest[i + 1 :]]

        def take(i: int, numbers: list[int]) -> None:
            scores[i, i + 1 :] = scores[i + 1 :, i] = numbers

        self._share_out("similar photographs looked for", work, range(len(largest)), take)
        return scores

    def compare(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Match the features of pairs, and keep those that one motion of a camera explains."""
        facts = [_FORMAT, self._colmap.__version__, str(self._verification.todict())]
        cameras = [str(camera.todict()) for camera in self._cameras]
        sizes = [len(one.points) for one in self._features]
        keys = {
            (i, j): _key([*facts, cameras[i], cameras[j]], self._keys[i], self._keys[j])
            for i, j in pairs
        }
        missing: list[tuple[int, int]] = []
        for pair in pairs:
            geometry = self._kept and _geometry_in(
                self._kept.get(keys[pair]), [sizes[n] for n in pair]
            )
            if geometry is None:
                missing.append(pair)
            else:
                self._geometries[pair] = geometry

        def take(pair: tuple[int, int], geometry: _Geometry) -> None:
            self._geometries[pair] = geometry
            if self._kept is not None:
                content = (
                    bytes([geometry.config])
                    + geometry.models.tobytes()
                    + geometry.matches.tobytes()
                )
                self._kept.put(keys[pair], content)

        self._share_out("pairs compared", self._compared, missing, take, len(pairs))

    def _compared(self, pair: tuple[int, int]) -> _Geometry:
        one, other = (self._features[n] for n in pair)
        cameras = [self._cameras[n] for n in pair]
        least = self._verification.min_num_inliers
        matches = nearest(one.descriptors.astype(np.float32), other.descriptors.astype(np.float32))
        nothing = _Geometry(0, np.full((3, 3, 3), np.nan), np.zeros((0, 2), np.uint32))
        if len(matches) < least:
            return nothing
        points = [each.points[:, :2].astype(np.float64) for each in (one, other)]
        geometry = self._colmap.estimate_two_view_geometry(
            cameras[0], points[0], cameras[1], points[1], matches, self._verification
        )
        if len(geometry.inlier_matches) < least:
            return nothing
        models = np.full((3, 3, 3), np.nan)
        for index, model in enumerate((geometry.E, geometry.F, geometry.H)):
            if model is not None:
                models[index] = model
        config = int(geometry.config)
        matches = np.asarray(geometry.inlier_matches, dtype=np.uint32).reshape(-1, 2)
        guided = self._guided(config, models, (one, other), points, cameras)
        matches = matches if guided is None else guided
        return _Geometry(config, models, matches) if len(matches) >= least else nothing

    def _guided(
        self,
        config: int,
        models: NDArray[np.float64],
        features: tuple[Features, Features],
        points: list[NDArray[np.float64]],
        cameras: list[Any],
    ) -> NDArray[np.uint32] | None:
        """Return the matches among what a motion of the camera allows; None if it allows all."""
        from nw_twin.calibrate.match_kernels import two_best_along, two_best_near

        kinds, (_, model, H) = self._colmap.TwoViewGeometryConfiguration, models
        error = float(self._verification.ransac.max_error)
        one, other = (each.descriptors for each in features)
        best = _Best.of(len(one), len(other))
        first, second = points
        if config in {int(kinds.PLANAR), int(kinds.PANORAMIC), int(kinds.PLANAR_OR_PANORAMIC)}:
            there = np.column_stack([first, np.ones(len(first))]) @ H.T
            with np.errstate(divide="ignore", invalid="ignore"):
                targets = np.ascontiguousarray(there[:, :2] / there[:, 2:])
            two_best_near(targets, second, error**2, one, other, best.arrays)
            return best.mutual()
        if config == int(kinds.CALIBRATED):
            first, second = (
                np.ascontiguousarray(camera.cam_from_img(each))
                for camera, each in zip(cameras, points, strict=True)
            )
            error *= 0.5 * sum(1.0 / camera.mean_focal_length() for camera in cameras)
            model = models[0]
        elif config != int(kinds.UNCALIBRATED):
            return None
        lines, back = _lines(model, first), _lines(model.T, second)
        two_best_along(lines, second, back[:, 3].copy(), error**2, one, other, best.arrays)
        return best.mutual()

    def _share_out(
        self,
        what: str,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        take: Callable[[_Item, _Result], None],
        total: int | None = None,
    ) -> None:
        """Let threads work on items; take the results in order. A signal ends it within one item.

        Args:
            what: is done, for lines of progress.
            work: on one item, in any thread.
            items: to work on.
            take: is given each result, in this thread.
            total: of items, those that were done before counted.
        """
        total = len(items) if total is None else total
        before = total - len(items)
        if before:
            self._say(f"{what}: {before} of {total} before, by the calibration that was cut off")
        pace = Pace(self._say, what, total, begun_at=before)
        pool = ThreadPoolExecutor(self._options.threads)
        try:
            running = [(item, pool.submit(work, item)) for item in items]
            for done, (item, each) in enumerate(running, 1):
                take(item, each.result())
                pace.at(before + done)
        finally:
            pool.shutdown(cancel_futures=True)

    def write(self, pairs: int) -> Matches:
        """Write features and matches into the database, and return its contents."""
        pycolmap, files = self._colmap, [one.file for one in self._photographs]
        kinds = pycolmap.TwoViewGeometryConfiguration
        flat = {int(kinds.PLANAR), int(kinds.PANORAMIC), int(kinds.PLANAR_OR_PANORAMIC)}
        good = {pair: one for pair, one in sorted(self._geometries.items()) if len(one.matches)}
        with (
            closing(pycolmap.Database.open(self._database)) as opened,
            pycolmap.DatabaseTransaction(opened),
        ):
            for file, features in zip(files, self._features, strict=True):
                opened.write_keypoints(self._images[file], features.points)
            for (i, j), one in good.items():
                geometry = pycolmap.TwoViewGeometry()
                geometry.config, geometry.inlier_matches = one.config, one.matches
                for name, model in zip("EFH", one.models, strict=True):
                    if np.isfinite(model).all():
                        setattr(geometry, name, model)
                first, second = self._images[files[i]], self._images[files[j]]
                opened.write_two_view_geometry(first, second, geometry)
                # Global mapping estimates motions again, from these.
                opened.write_matches(first, second, one.matches)
        return Matches(
            database=self._database,
            pictures=self._pictures,
            features={
                file: len(each.points) for file, each in zip(files, self._features, strict=True)
            },
            inliers={(files[i], files[j]): len(one.matches) for (i, j), one in good.items()},
            pairs=pairs,
            turned=sum(one.config in flat for one in good.values()),
        )

    def _reader(self, lens: Lens | None, one: Photograph) -> Any:
        """Return how COLMAP enters pictures: by the lens, or EXIF's focal length to start."""
        model = lens.model if lens else self._options.lens
        reader, params = self._colmap.ImageReaderOptions(camera_model=model), lens and lens.params
        if lens is None and one.focal is not None:
            camera = self._colmap.Camera.create_from_model_name(
                1, model, one.focal, one.width, one.height
            )
            params = camera.params
        if params is not None:
            reader.camera_params = ",".join(repr(float(p)) for p in params)
        return reader

    def _forget(self) -> None:
        """Give unknown cameras COLMAP's guess of the focal length: it reads EXIF by itself."""
        unknown = {
            one.file
            for one, lens in zip(self._photographs, self._lenses, strict=True)
            if lens is None and one.focal is None
        }
        with closing(self._colmap.Database.open(self._database)) as opened:
            used = {i.camera_id for i in opened.read_all_images() if i.name in unknown}
            for camera in opened.read_all_cameras():
                if camera.camera_id in used and camera.has_prior_focal_length:
                    focal = _GUESS * max(camera.width, camera.height)
                    guess = self._colmap.Camera.create_from_model_name(
                        camera.camera_id, self._options.lens, focal, camera.width, camera.height
                    )
                    opened.update_camera(guess)


def _lines(F: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return F x (N, 4) of points (N, 2), and the first two numbers squared, added."""
    x, y = points.T
    a, b, c = (F[r, 0] * x + F[r, 1] * y + F[r, 2] for r in range(3))
    return np.column_stack([a, b, c, a * a + b * b])


def _key(facts: Iterable[object], *digests: bytes) -> bytes:
    content = json.dumps([str(fact) for fact in facts]).encode()
    return hashlib.sha256(b"".join([hashlib.sha256(content).digest(), *digests])).digest()


def _digest(path: Path | None) -> bytes:
    return hashlib.sha256(b"" if path is None else path.read_bytes()).digest()


def _features_in(content: bytes | None) -> Features | None:
    """Return features as they were kept; None where there are none, or damaged ones."""
    if content is None or len(content) % 144:
        return None
    count = len(content) // 144
    points = np.frombuffer(content[: 16 * count], np.float32).reshape(-1, 4)
    if not np.isfinite(points).all():
        return None
    return Features(points, np.frombuffer(content[16 * count :], np.uint8).reshape(-1, 128))


def _geometry_in(content: bytes | None, features: list[int]) -> _Geometry | None:
    """Return a pair's geometry as it was kept; None where there is none, or a damaged one."""
    if content is None or len(content) < 217 or (len(content) - 217) % 8:
        return None
    matches = np.frombuffer(content[217:], np.uint32).reshape(-1, 2)
    if (matches >= np.array(features)).any():
        return None
    models = np.frombuffer(content[1:217], np.float64).reshape(3, 3, 3)
    return _Geometry(content[0], models, matches)
