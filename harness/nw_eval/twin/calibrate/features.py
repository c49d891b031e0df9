"""Features of photographs and which of them match, in a database of COLMAP."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.options import CalibrateOptions
from nw_eval.twin.calibrate.pace import Pace, Say
from nw_eval.twin.calibrate.packages import quiet
from nw_eval.twin.calibrate.photographs import Photograph
from nw_eval.twin.calibrate.solution import Lens

_GUESS = 1.2
"""Focal length in longer sides, as COLMAP has it where nothing is known."""
_FAINT = 0.003
"""Contrast of a feature, at least; COLMAP's own 0.0067 finds too few on plain floors. With shapes
and sizes of features measured and matches looked for along what a pair's motion allows, walks of 40
photographs of six built-in courses are all placed, one picture of them wrongly; 25 to 40 of each
were."""
_AT_ONCE = 6
"""Photographs between two looks at the clock."""

Groups = list[tuple[Lens | None, list[Photograph]]]


@dataclass(frozen=True, kw_only=True)
class Matches:
    """A database of COLMAP with features and verified matches, and what is in it.

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


def match(
    photographs: Sequence[Photograph],
    lenses: Sequence[Lens | None],
    pairs: Sequence[tuple[int, int]],
    working: Path,
    options: CalibrateOptions,
    say: Say,
) -> Matches:
    """Find features and compare pairs of photographs.

    The result does not depend on threads: pictures have their numbers before they are shared out,
    pairs are compared one after the other, and each has its own random numbers.

    Args:
        photographs: in the working folder's `pictures`.
        lenses: as they are known, for each photograph; None where they are to be found.
        pairs: of places in photographs.
        working: gets `matches.db`.
        options: of the calibration.
        say: is given lines of progress.

    Raises:
        SceneError: COLMAP fails.
    """
    with quiet() as pycolmap:
        try:
            matching = _Matching(pycolmap, photographs, lenses, working, options, say)
            matching.enter()
            matching.extract()
            matching.compare(pairs)
            return matching.read(len(pairs))
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            raise SceneError(
                f"COLMAP could not compare the photographs: {error}",
                fix="look at the photographs; fewer or smaller ones need less memory",
            ) from None


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
    ) -> None:
        self._colmap, self._options, self._say = pycolmap, options, say
        self._photographs, self._lenses, self._working = photographs, lenses, working
        self._database, self._pictures = working / "matches.db", photographs[0].path.parent
        # Photographs share a camera: its lens if it is known, else by size and EXIF focal length.
        found: dict[Any, tuple[Lens | None, list[Photograph]]] = {}
        for one, lens in zip(photographs, lenses, strict=True):
            focal = None if one.focal is None else round(one.focal, 1)
            key = lens or (one.width, one.height, focal)
            found.setdefault(key, (lens, []))[1].append(one)
        self._groups = list(found.values())

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

    def extract(self) -> None:
        """Find features."""
        pycolmap, masks = self._colmap, self._masks()
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads, extraction.use_gpu = self._options.threads, False
        extraction.max_image_size = self._options.side
        extraction.sift.max_num_features = self._options.features
        extraction.sift.peak_threshold = _FAINT
        extraction.sift.estimate_affine_shape = extraction.sift.domain_size_pooling = True
        done, pace = 0, Pace(self._say, "features found", sum(len(m) for _, m in self._groups))
        for lens, members in self._groups:
            reader = self._reader(lens, members[0])
            if masks is not None:
                reader.mask_path = masks
            for first in range(0, len(members), _AT_ONCE):
                some = members[first : first + _AT_ONCE]
                pycolmap.extract_features(
                    self._database,
                    self._pictures,
                    image_names=[one.file for one in some],
                    camera_mode=pycolmap.CameraMode.SINGLE,
                    reader_options=reader,
                    extraction_options=extraction,
                    device=pycolmap.Device.cpu,
                )
                done += len(some)
                pace.at(done)

    def compare(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Match the features of pairs, and keep those that one motion of a camera explains."""
        pycolmap, photographs = self._colmap, self._photographs
        matching = pycolmap.FeatureMatchingOptions()
        # Threads that compare at once spoil each other's (pycolmap 4.2.1): pairs lost most of their
        # matches in one of eleven runs with two of them, and in both with three.
        matching.num_threads, matching.use_gpu = 1, False
        matching.guided_matching = True
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = self._options.seed
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = self._working / "pairs.txt"
        pace = Pace(self._say, "pairs compared", len(pairs))
        at_once = max(60, math.ceil(len(pairs) / 50))  # Each beginning reads all features again.
        for first in range(0, len(pairs), at_once):
            some = pairs[first : first + at_once]
            lines = (f"{photographs[i].file} {photographs[j].file}\n" for i, j in some)
            pairing.match_list_path.write_text("".join(lines), encoding="ascii")
            pycolmap.match_image_pairs(
                self._database,
                matching_options=matching,
                pairing_options=pairing,
                verification_options=verification,
                device=pycolmap.Device.cpu,
            )
            pace.at(first + len(some))

    def read(self, pairs: int) -> Matches:
        """Return what was found."""
        flat = self._colmap.TwoViewGeometryConfiguration
        kinds = (flat.PLANAR, flat.PANORAMIC, flat.PLANAR_OR_PANORAMIC)
        with closing(self._colmap.Database.open(self._database)) as opened:
            images = opened.read_all_images()
            turned = sum(one.config in kinds for one in opened.read_two_view_geometries()[1])
            names = {image.image_id: image.name for image in images}
            features = {
                image.name: int(opened.num_keypoints_for_image(image.image_id)) for image in images
            }
            inliers: dict[tuple[str, str], int] = {}
            for pair, count in zip(*opened.read_two_view_geometry_num_inliers(), strict=True):
                first, second = self._colmap.pair_id_to_image_pair(pair)
                inliers[names[first], names[second]] = int(count)
        return Matches(
            database=self._database,
            pictures=self._pictures,
            features=features,
            inliers=inliers,
            pairs=pairs,
            turned=turned,
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

    def _masks(self) -> Path | None:
        """Return the folder of masks, or None without; who lacks a mask gets a white one."""
        if all(one.mask is None for one in self._photographs):
            return None
        for one in self._photographs:
            if one.mask is None:
                white = np.full((one.height, one.width), 255, np.uint8)
                Image.fromarray(white).save(self._working / "masks" / f"{one.file}.png")
        return self._working / "masks"
