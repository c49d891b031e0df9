"""Features of photographs and which of them match, in a database of COLMAP."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    database = working / "matches.db"
    with quiet() as pycolmap:
        try:
            pycolmap.Database.open(database).close()
            groups = _groups(photographs, lenses)
            masks = _masks(photographs, working)
            for lens, members in groups:
                _enter(pycolmap, database, lens, members, options)
            _forget(pycolmap, database, photographs, lenses, options)
            _extract(pycolmap, database, groups, masks, options, say)
            _compare(pycolmap, database, photographs, pairs, working, options, say)
            return _read(pycolmap, database, photographs, len(pairs))
        except (RuntimeError, ValueError, IndexError, MemoryError) as error:
            raise SceneError(
                f"COLMAP could not compare the photographs: {error}",
                fix="look at the photographs; fewer or smaller ones need less memory",
            ) from None


def _groups(photographs: Sequence[Photograph], lenses: Sequence[Lens | None]) -> Groups:
    """Return photographs that share a camera: its lens if it is known, else size and EXIF focal."""
    found: dict[Any, tuple[Lens | None, list[Photograph]]] = {}
    for one, lens in zip(photographs, lenses, strict=True):
        focal = None if one.focal is None else round(one.focal, 1)
        key = lens or (one.width, one.height, focal)
        found.setdefault(key, (lens, []))[1].append(one)
    return list(found.values())


def _reader(pycolmap: Any, lens: Lens | None, one: Photograph, options: CalibrateOptions) -> Any:
    """Return options by which COLMAP enters pictures: the lens, or EXIF's focal length to start."""
    reader = pycolmap.ImageReaderOptions(camera_model=lens.model if lens else options.lens)
    if lens is not None:
        reader.camera_params = ",".join(repr(float(p)) for p in lens.params)
    elif one.focal is not None:
        camera = pycolmap.Camera.create_from_model_name(
            1, options.lens, one.focal, one.width, one.height
        )
        reader.camera_params = ",".join(repr(float(p)) for p in camera.params)
    return reader


def _enter(
    pycolmap: Any,
    database: Path,
    lens: Lens | None,
    members: list[Photograph],
    options: CalibrateOptions,
) -> None:
    pycolmap.import_images(
        database,
        members[0].path.parent,
        camera_mode=pycolmap.CameraMode.SINGLE,
        image_names=[one.file for one in members],
        options=_reader(pycolmap, lens, members[0], options),
    )


def _forget(
    pycolmap: Any,
    database: Path,
    photographs: Sequence[Photograph],
    lenses: Sequence[Lens | None],
    options: CalibrateOptions,
) -> None:
    """Give cameras of which nothing is known COLMAP's guess: it reads EXIF of its own accord."""
    unknown = {
        one.file
        for one, lens in zip(photographs, lenses, strict=True)
        if lens is None and one.focal is None
    }
    opened = pycolmap.Database.open(database)
    try:
        used = {i.camera_id for i in opened.read_all_images() if i.name in unknown}
        for camera in opened.read_all_cameras():
            if camera.camera_id in used and camera.has_prior_focal_length:
                focal = _GUESS * max(camera.width, camera.height)
                guess = pycolmap.Camera.create_from_model_name(
                    camera.camera_id, options.lens, focal, camera.width, camera.height
                )
                opened.update_camera(guess)
    finally:
        opened.close()


def _masks(photographs: Sequence[Photograph], working: Path) -> Path | None:
    """Return the folder of masks, or None without; a photograph that lacks one gets a white one."""
    if all(one.mask is None for one in photographs):
        return None
    for one in photographs:
        if one.mask is None:
            white = np.full((one.height, one.width), 255, np.uint8)
            Image.fromarray(white).save(working / "masks" / f"{one.file}.png")
    return working / "masks"


def _extract(
    pycolmap: Any,
    database: Path,
    groups: Groups,
    masks: Path | None,
    options: CalibrateOptions,
    say: Say,
) -> None:
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = options.threads, False
    extraction.max_image_size = options.side
    extraction.sift.max_num_features = options.features
    extraction.sift.peak_threshold = _FAINT
    extraction.sift.estimate_affine_shape = extraction.sift.domain_size_pooling = True
    done, pace = 0, Pace(say, "features found", sum(len(m) for _, m in groups))
    for lens, members in groups:
        reader = _reader(pycolmap, lens, members[0], options)
        if masks is not None:
            reader.mask_path = masks
        for first in range(0, len(members), _AT_ONCE):
            some = members[first : first + _AT_ONCE]
            pycolmap.extract_features(
                database,
                some[0].path.parent,
                image_names=[one.file for one in some],
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
            )
            done += len(some)
            pace.at(done)


def _compare(
    pycolmap: Any,
    database: Path,
    photographs: Sequence[Photograph],
    pairs: Sequence[tuple[int, int]],
    working: Path,
    options: CalibrateOptions,
    say: Say,
) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    # Threads that compare at once spoil each other's (pycolmap 4.2.1): pairs lost most of their
    # matches in one of eleven runs with two of them, and in both with three.
    matching.num_threads, matching.use_gpu = 1, False
    matching.guided_matching = True
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = working / "pairs.txt"
    pace = Pace(say, "pairs compared", len(pairs))
    at_once = max(60, math.ceil(len(pairs) / 50))  # Each beginning reads all features again.
    for first in range(0, len(pairs), at_once):
        some = pairs[first : first + at_once]
        lines = (f"{photographs[i].file} {photographs[j].file}\n" for i, j in some)
        pairing.match_list_path.write_text("".join(lines), encoding="ascii")
        pycolmap.match_image_pairs(
            database,
            matching_options=matching,
            pairing_options=pairing,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
        pace.at(first + len(some))


def _read(pycolmap: Any, database: Path, photographs: Sequence[Photograph], pairs: int) -> Matches:
    opened = pycolmap.Database.open(database)
    flat = pycolmap.TwoViewGeometryConfiguration
    kinds = (flat.PLANAR, flat.PANORAMIC, flat.PLANAR_OR_PANORAMIC)
    try:
        images = opened.read_all_images()
        turned = sum(geometry.config in kinds for geometry in opened.read_two_view_geometries()[1])
        names = {image.image_id: image.name for image in images}
        features = {
            image.name: int(opened.num_keypoints_for_image(image.image_id)) for image in images
        }
        inliers: dict[tuple[str, str], int] = {}
        for pair, count in zip(*opened.read_two_view_geometry_num_inliers(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair)
            inliers[names[first], names[second]] = int(count)
    finally:
        opened.close()
    return Matches(
        database=database,
        pictures=photographs[0].path.parent,
        features=features,
        inliers=inliers,
        pairs=pairs,
        turned=turned,
    )
