"""Photographs taken in: each decoded once, so that what follows meets none that is damaged.

Also here: what was found at a path, masks beside photographs, and cameras if somebody knows them.
"""

from __future__ import annotations

import json
import math
import re
import struct
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside, regular
from nw_base.files.pictures import KINDS, open_picture
from nw_base.plural import plural
from nw_twin.calibrate.report import LeftOut, Pace, Say
from nw_twin.calibrate.solution import Solution
from nw_twin.lens import Lens
from nw_twin.options import MOST_MEGAPIXELS
from nw_twin.packages import package, quiet

_NOT_READ = frozenset({".dng", ".cr2", ".cr3", ".nef", ".arw"})
_HEIC = frozenset({".heic", ".heif", ".hif"})
SUFFIXES = _NOT_READ | _HEIC | {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".avif"}
"""What is meant as a photograph; those that Pillow does not read are named as unreadable."""
UNREADABLE = "cannot be read"
DAMAGE = (
    *(OSError, ValueError, SyntaxError, EOFError, MemoryError, TypeError, LookupError),
    *(Image.DecompressionBombError, RuntimeError, struct.error),
)
"""What Pillow raises at damaged files; RuntimeError at HEIC that is larger than libheif takes."""
_EXIF_ORIENTATION = 0x0112
_ASIDE = (5, 6, 7, 8)
"""Orientations by which width becomes height."""
_LEAST_SIDE, _LONGEST = 8, 50
"""Pixels of the shorter side at least, and how many times it the longer one is at most."""
_MOST_EXIF = 65_000
"""Bytes of EXIF that a JPEG takes."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """A file that a source names.

    Attributes:
        name: of the photograph.
        path: of its file; None if it must not be read, and then `fault` says why.
        mask: file of its mask, where 0 is no part of the scene.
        fault: why it cannot be used.
    """

    name: str
    path: Path | None
    mask: Path | None = None
    fault: str | None = None


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """A photograph that can be read.

    Attributes:
        name: of the photograph.
        file: in the working folder, `pictures/000012.jpg`: plain names, upright, RGB or grey.
        path: of that file.
        mask: of the picture's size, 0 or 255, in the working folder.
        width, height: pixels.
        focal: by EXIF, pixels; None where it does not say.
        sharpness: variance of the Laplacian at 640 pixels, grey values squared.
        contrast: standard deviation of grey values.
        brightness: mean grey value, 0 to 255.
    """

    name: str
    file: str
    path: Path
    mask: Path | None
    width: int
    height: int
    focal: float | None
    sharpness: float
    contrast: float
    brightness: float


def natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """Return a key that sorts IMG_9 before IMG_10."""
    parts = re.split(r"([0-9]+)", name)
    key = ((1, int(part)) if i % 2 else (0, part) for i, part in enumerate(parts))
    return (*key, (0, name))


def are_numbered(names: Sequence[str]) -> bool:
    """Return whether names differ in their numbers alone, as frames and a camera's files do."""
    return len(names) > 1 and len({re.sub(r"[0-9]+", "0", name) for name in names}) == 1


def take_in(
    files: Sequence[Found],
    working: Path,
    say: Say,
    *,
    cameras: Solution | None = None,
    megapixels: int = 100,
) -> tuple[list[Photograph], list[LeftOut]]:
    """Decode all photographs once; bring them and their masks into the working folder.

    Args:
        files: in their order, which is kept.
        working: gets `pictures/` and `masks/`.
        say: is given lines of progress.
        cameras: as they are known; None where they are to be found. Without, photographs are turned
            as EXIF says. With, only those that have the shape of their camera's pictures when they
            are turned, and not as they are: COLMAP and nerfstudio read pixels as they are stored.
        megapixels: of one, at most.

    Returns:
        Those that can be read, and those that cannot.

    Raises:
        SceneError: a mask cannot be read or is of another size than its photograph.
    """
    for name in ("pictures", "masks"):
        (working / name).mkdir()
    good: list[Photograph] = []
    bad: list[LeftOut] = []
    lenses = {} if cameras is None else {one.name: one.lens for one in cameras.placed}
    pace = Pace(say, "photographs read", len(files))
    hdr: list[str] = []
    for number, one in enumerate(files):
        fault = one.fault
        if one.path is not None:
            try:
                path = regular(one.path)
                lens = lenses.get(one.name)
                good.append(_take_in(one, path, number, working, megapixels, lens, hdr))
            except DAMAGE as error:
                fault = _why(one.path, error)
        if fault is not None:
            bad.append(LeftOut(name=one.name, reason=UNREADABLE, detail=fault))
        pace.at(number + 1)
    if hdr:
        say(f"{plural(len(hdr), 'photograph')} in HDR, as {hdr[0]}: tone-mapped to sRGB")
    return good, bad


def _why(path: Path, error: Exception) -> str:
    """Return why a file cannot be read, and what to do if its kind is known."""
    kind = path.suffix[1:].upper()
    if path.suffix.lower() in _NOT_READ:
        return f"{kind} is not read here: export as JPEG"
    if path.suffix.lower() in _HEIC and find_spec("pillow_heif") is None:
        return f"{kind} needs the package pillow-heif: pip install 'nw-eval[twin]'"
    if isinstance(error, Image.DecompressionBombError):
        return f"over {MOST_MEGAPIXELS} million pixels, too many: make it smaller"
    if isinstance(error, UnidentifiedImageError):
        return f"no {KINDS}, or damaged"
    if "PngImagePlugin" in str(error):
        return "its colour profile or text is larger than any is: save it without"
    return str(error).strip()


def _take_in(
    one: Found,
    path: Path,
    number: int,
    working: Path,
    megapixels: int,
    lens: Lens | None,
    hdr: list[str],
) -> Photograph:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of damaged EXIF, which then says nothing.
        with open_picture(path) as image:
            if min(image.size) < max(_LEAST_SIDE, max(image.size) / _LONGEST):
                raise ValueError(f"{image.width} x {image.height} pixels are not a photograph")
            if image.width * image.height > megapixels * 1e6:
                raise ValueError(
                    f"{image.width * image.height / 1e6:.3g} million pixels, of "
                    f"{megapixels} million at most: make it smaller, or give --megapixels"
                )
            if image.mode.startswith(("I", "F")):
                raise ValueError(f"its grey values are {image.mode}; save it with 8 bits")
            if b"equirectangular" in _xmp(image):
                raise ValueError("a panorama, by its XMP: cut it into flat pictures")
            image.load()
            turned = _is_to_turn(image, lens)
            jpeg = image.format in {"JPEG", "MPO"}  # A phone's JPEG with a depth map is an MPO.
            plain = (jpeg or image.format == "PNG") and image.mode in {"RGB", "L"} and not turned
            suffix = ".jpg" if jpeg or image.format == "HEIF" else ".png"
            exif = (image.info.get("exif") or b"") if image.format == "HEIF" else b""
            transfer = (image.info.get("nclx_profile") or {}).get("transfer_characteristics")
            upright_image = (ImageOps.exif_transpose(image) if turned else image).convert("RGB")
    if transfer in HDR:
        hdr.append(one.name)
        upright_image = Image.fromarray(tone_mapped(np.asarray(upright_image), transfer))
    target = working / "pictures" / f"{number:06d}{suffix}"
    if plain:
        target.symlink_to(path.resolve())
    elif suffix == ".jpg":
        exif = exif if len(exif) < _MOST_EXIF else b""
        upright_image.save(target, quality=98, subsampling=0, exif=exif)
    else:
        upright_image.save(target, compress_level=1)
    grey = np.asarray(upright_image.convert("L"))
    sharpness, contrast = sharpness_of(grey)
    height, width = grey.shape
    return Photograph(
        name=one.name,
        file=target.name,
        path=target,
        mask=_mask(one, target, (width, height), working),
        width=width,
        height=height,
        # COLMAP opens no HEIC: EXIF was copied.
        focal=_focal(target if exif else path, (width, height)),
        sharpness=sharpness,
        contrast=contrast,
        brightness=float(grey.mean()),
    )


def _xmp(image: Image.Image) -> bytes:
    packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    return packet if isinstance(packet, bytes) else str(packet).encode(errors="replace")


def upright_size(path: Path, lens: Lens | None) -> tuple[int, int] | None:
    """Return width and height of a photograph, turned as `take_in` turns it; None if damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_picture(path) as image:
                width, height = image.size
                is_aside = image.getexif().get(_EXIF_ORIENTATION, 1) in _ASIDE
                is_turned = is_aside and _is_to_turn(image, lens)
                return (height, width) if is_turned else (width, height)
    except (*DAMAGE, SceneError):
        return None


def _is_to_turn(image: Image.Image, lens: Lens | None) -> bool:
    if image.getexif().get(_EXIF_ORIENTATION, 1) == 1:
        return False
    if lens is None:
        return True
    (long, short), (w, h) = (lens.width, lens.height), image.size
    as_it_is, turned = abs(long * h - short * w), abs(long * w - short * h)
    return turned < as_it_is


HDR = {16: "PQ", 18: "HLG"}
"""Transfer characteristics of HDR by their numbers in ITU-T H.273."""
_BT709 = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)
"""Linear light of BT.2020's primaries to BT.709's: ITU-R BT.2087."""
_KNEE = 0.75
"""Of reference white: what is brighter is pressed into the rest."""


def tone_mapped(signal: NDArray[np.integer], transfer: int) -> NDArray[np.uint8]:
    """Return an HDR picture of BT.2020's colours as sRGB.

    Light up to 3/4 of reference white stays as it is, brighter light is pressed into the rest
    without a change of hue. PQ and HLG: ITU-R BT.2100; reference white: BT.2408.

    Args:
        signal: (H, W, 3) uint8 or uint16, over its whole range.
        transfer: 16 for PQ, 18 for HLG.
    """
    x = np.linspace(0.0, 1.0, np.iinfo(signal.dtype).max + 1)
    if HDR[transfer] == "PQ":
        root = x ** (32 / 2523)
        light = np.maximum(root - 107 / 128, 0) / (2413 / 128 - 2392 / 128 * root)
        light = (10_000 / 203 * light ** (8192 / 1305)) ** (1 / 1.2)  # PQ is of the screen's light.
    else:
        light = np.where(
            x <= 0.5, x * x / 3, (np.exp((x - 0.55991073) / 0.17883277) + 0.28466892) / 12
        )
        light /= np.interp(0.75, x, light)
    rgb = np.maximum(light.astype(np.float32)[signal] @ _BT709.T, 0)
    peak = np.maximum(rgb.max(axis=-1, keepdims=True), 1e-6)
    rest = 1 - _KNEE
    rgb *= np.where(peak > _KNEE, 1 - rest * np.exp((_KNEE - peak) / rest), peak) / peak
    steps = np.linspace(0.0, 1.0, 4096)
    srgb = np.where(steps <= 0.0031308, 12.92 * steps, 1.055 * steps ** (1 / 2.4) - 0.055)
    return np.round(255 * srgb).astype(np.uint8)[np.round(4095 * rgb).astype(np.uint16)]


def sharpness_of(grey: NDArray[np.uint8]) -> tuple[float, float]:
    """Return the variance of the Laplacian, and contrast, of a picture brought to 640 pixels."""
    cv2 = package("cv2")
    scale = 640 / max(grey.shape)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_64F).var()), float(small.std())


def _focal(path: Path, size: tuple[int, int]) -> float | None:
    """Return the focal length that EXIF says, in pixels; the turn of the picture is no matter."""
    with quiet() as pycolmap:
        try:
            camera = pycolmap.infer_camera_from_image(path)
        except (ValueError, RuntimeError):  # A kind of file that Pillow alone reads.
            return None
    focal = float(camera.mean_focal_length())
    if not camera.has_prior_focal_length or not 0.2 < focal / max(size) < 20:
        return None
    return focal


def _mask(one: Found, target: Path, size: tuple[int, int], working: Path) -> Path | None:
    """Write a photograph's mask where COLMAP looks for it: `masks/<file>.png`."""
    if one.mask is None:
        return None
    try:
        with open_picture(one.mask) as image:
            mask_size = image.size
            kept = np.asarray(image.convert("L")) > 0 if mask_size == size else None
    except DAMAGE as error:
        raise SceneError(
            f"the mask {one.mask} cannot be read: {error}", fix="write it again, or remove it"
        ) from None
    if kept is None:
        raise SceneError(
            f"the mask {one.mask} has {mask_size} pixels, {one.name} has {size}",
            fix="write it in its photograph's size",
        )
    path = working / "masks" / f"{target.name}.png"
    Image.fromarray(kept.astype(np.uint8) * 255).save(path)
    return path


_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True)
class Footage:
    """Input of a calibration: photographs and known cameras.

    Attributes:
        kind: what it is.
        files: photographs in the order of their names.
        is_film: whether they are frames of a video, each beside the one before.
        cameras: as they are known, by the files' names; None where they are to be found.
        metric: whether these cameras are in metres.
        up: (3,) unit vector in the frame of these cameras; None where their source does not say.
        notes: what its files say that nothing is made of, by name.
    """

    kind: Literal["photographs", "video", "colmap", "nerfstudio", "polycam", "record3d", "arkit"]
    files: tuple[Found, ...]
    is_film: bool = False
    cameras: Solution | None = None
    metric: bool = False
    up: tuple[float, float, float] | None = None
    notes: tuple[str, ...] = ()


def found_in(folder: Path, name: str, *, called: str | None = None) -> Found:
    """Return a photograph of a folder; one that lies elsewhere is found, and not to be read.

    Args:
        folder: that it must lie in.
        name: relative to it.
        called: its name as a photograph; None = the same.
    """
    try:
        path = inside(folder, name)
    except OutsideError as error:
        return Found(name=called or name, path=None, fault=f"it is not in {folder}: {error}")
    return Found(name=called or name, path=path)


def in_order(files: Iterable[Found]) -> tuple[Found, ...]:
    """Return files as footage has them."""
    return tuple(sorted(files, key=lambda one: natural(one.name)))


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises:
        SceneError: the file is missing, or has no JSON object.
    """
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise SceneError(f"{path} is larger than {_MOST_BYTES} bytes", fix="export it again")
        value = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise SceneError(f"{path} cannot be read: {error}", fix="export it again") from None
    if not isinstance(value, dict):
        raise SceneError(f"{path} holds no JSON object", fix="export it again")
    return value


def number(value: Any, what: str) -> float:
    """Return a finite number of an untrusted file.

    Raises:
        SceneError: the value is no number; the message names it.
    """
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or abs(value) > 1e15 or math.isnan(value):
        raise SceneError(f"{what} is {value!r}, no number", fix="export the cameras again")
    return float(value)


def photographs_in(folder: Path) -> Footage | None:
    """Return the photographs of a folder, or of `images` in it; None if there are none."""
    for place, beside in ((folder, ()), (folder / "images", (folder,))):
        names = names_in(place, SUFFIXES)
        if names:
            files = [found_in(place, name) for name in names]
            files = with_masks(files, [place / "masks", *(b / "masks" for b in beside)])
            return Footage(kind="photographs", files=in_order(files))
    return None


def names_in(folder: Path, suffixes: frozenset[str]) -> list[str]:
    """Return names of the files in a folder with such suffixes; hidden ones are no photographs."""
    if not folder.is_dir():
        return []
    return [
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and not path.is_dir()
    ]


def with_masks(files: list[Found], folders: list[Path]) -> list[Found]:
    """Return photographs with their masks: `IMG_1.jpg.png` or `IMG_1.png` for `IMG_1.jpg`.

    Raises:
        SceneError: a mask is a link that leads out of its folder.
    """
    folder = next((place for place in folders if place.is_dir()), None)
    if folder is None:
        return files
    masks = {name.lower(): name for name in sorted(names_in(folder, SUFFIXES))}
    stems = {Path(name).stem.lower(): name for name in sorted(names_in(folder, SUFFIXES))}
    photographs: list[Found] = []
    for one in files:
        name = one.name.lower()
        mask = masks.get(f"{name}.png") or stems.get(Path(name).stem)
        try:
            photographs.append(one if mask is None else replace(one, mask=inside(folder, mask)))
        except OutsideError as error:
            raise SceneError(
                f"the mask {mask} is not in {folder}: {error}", fix="copy it there"
            ) from None
    return photographs
