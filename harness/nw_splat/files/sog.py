"""SOG, PlayCanvas's format: numbers in lossless WebP images, described by meta.json.

A .sog file is a zip of both; a folder of the same files is read by its meta.json. Positions are 16
bits of sign(x) log(1 + |x|) between two bounds; rotations three of four components and a tag which
one is left out. In version 2 scales, colours and harmonics are places in codebooks; in version 1,
which has no `version`, shares between bounds. Harmonics come from a palette of up to 65,536 sets.
Axes are those of a 3DGS PLY. After splat-transform 2.7.1 (read-sog.ts, read-sog-v1.ts).
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside
from nw_base.files.pictures import open_picture
from nw_base.words import RasterizeMode
from nw_splat.files.format import SplatFormat
from nw_splat.gaussians import Gaussians, check_count, logit

META = "meta.json"
_BROKEN = "the file is damaged; export it again"
_BYTES = 1 << 29
_PIXELS = 1 << 20
_WIDTHS = {192: 3, 512: 8, 960: 15}
"""Of a palette's image, 64 sets a row, to harmonics above the constant."""
_BOUNDS = ("files", "mins", "maxs", "shape", "dtype")
_KEYS: dict[str, tuple[str, ...]] = {
    "version": (), "count": (), "antialias": (), "asset": ("generator", "version"),
    "means": _BOUNDS, "scales": (*_BOUNDS, "codebook"), "sh0": (*_BOUNDS, "codebook"),
    "quats": (*_BOUNDS, "encoding"),
    "shN": (*_BOUNDS, "codebook", "bands", "count", "quantization"),
}  # fmt: skip
"""What is read of meta.json, or says again what the images say."""
_FAULTS = (
    ArithmeticError, AttributeError, LookupError, NotImplementedError, OSError, RecursionError,
    RuntimeError, SyntaxError, TypeError, ValueError, zipfile.BadZipFile,
)  # fmt: skip

Bytes = NDArray[np.uint8]


def is_sog(path: Path) -> bool:
    """Return whether a zip file is one of SOG."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.rpartition("/")[2] == META for name in archive.namelist())
    except _FAULTS:
        return False


def read_sog(path: Path) -> Gaussians:
    """Read a .sog file, or the meta.json of one that is not zipped.

    Raises:
        SceneError: for damage of any kind, or sizes out of proportion to the file.
    """
    try:
        if path.name == META:
            size = sum(one.stat().st_size for one in path.parent.iterdir())
            return _Sog(path, _folder(path), size).read()
        with zipfile.ZipFile(path) as archive:
            return _Sog(path, _members(path, archive), path.stat().st_size).read()
    except SceneError:
        raise
    except _FAULTS as error:
        raise SceneError(
            f"{path}: no readable SOG: {type(error).__name__}: {clean(str(error), at_most=120)}",
            fix=_BROKEN,
        ) from None


def _folder(path: Path) -> Callable[[str], bytes]:
    def load(name: str) -> bytes:
        try:
            file = inside(path.parent, name)
        except OutsideError as error:
            raise SceneError(f"{path}: {error}", fix="put all files beside it") from None
        if file.stat().st_size > _BYTES:
            raise SceneError(f"{file}: more than {_BYTES} bytes", fix="prune the splat")
        return file.read_bytes()

    return load


def _members(path: Path, archive: zipfile.ZipFile) -> Callable[[str], bytes]:
    metas = [name for name in archive.namelist() if name.rpartition("/")[2] == META]
    if len(metas) != 1:
        raise SceneError(f"{path}: {len(metas)} files {META} in it", fix="give one splat a file")
    above = metas[0].removesuffix(META)
    size = path.stat().st_size

    def load(name: str) -> bytes:
        entry = archive.getinfo(above + name)
        if entry.file_size > min(_BYTES, max(100 * size, 1 << 20)):
            raise SceneError(
                f"{path}: {size} bytes claim to expand to {entry.file_size}",
                fix="the file is damaged or forged",
            )
        return archive.read(entry)

    return load


class _Sog:
    def __init__(self, path: Path, load: Callable[[str], bytes], size: int) -> None:
        self.path, self.load = path, load
        self.meta: dict[str, Any] = json.loads(load(META))
        self.version = self.meta.get("version", 1)
        if self.version not in (1, 2):
            raise SceneError(
                f"{path}: SOG version {clean(str(self.version), at_most=20)}",
                fix="versions 1 and 2 are read",
            )
        of = self.meta["means"]["shape"][0] if self.version == 1 else self.meta["count"]
        self.count = int(of)
        check_count(path, self.count)
        if not 0 < self.count <= max(1 << 16, 4 * size):
            raise SceneError(f"{path}: {self.count} Gaussians in {size} bytes", fix=_BROKEN)

    def read(self) -> Gaussians:
        """Decode all of it."""
        low, high = self._image("means", 0), self._image("means", 1)
        bits = (high[:, :3].astype(np.int64) << 8) | low[:, :3]
        logs = self._between("means", bits / 65535)
        rgba = self._image("sh0")
        if self.version == 1:
            scales = self._between("scales", self._image("scales")[:, :3] / 255)
            colours = self._between("sh0", rgba / 255)
            dc, opacity_logits = colours[:, :3], colours[:, 3]
        else:
            scales = self._codebook("scales")[self._image("scales")[:, :3]]
            dc, opacity_logits = self._codebook("sh0")[rgba[:, :3]], logit(rgba[:, 3] / 255)
        mode: RasterizeMode | None = None
        if isinstance(self.meta.get("antialias"), bool):
            mode = "antialiased" if self.meta["antialias"] else "classic"
        sh = np.concatenate([dc[:, None], self._harmonics()], axis=1)
        return Gaussians(
            means=(np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32),
            log_scales=scales.astype(np.float32),
            quats=self._quats().astype(np.float32),
            opacity_logits=opacity_logits.astype(np.float32),
            sh=sh.astype(np.float32),
            rasterize_mode=mode,
            notes=self._unread(),
        )

    def _unread(self) -> tuple[str, ...]:
        """Return keys of meta.json that are not read, by name; `asset` says who wrote it."""
        names = [str(key) for key in self.meta if key not in _KEYS]
        for key, fields in _KEYS.items():
            part = self.meta.get(key)
            if isinstance(part, dict):
                names += [f"{key}.{name}" for name in part if name not in fields]
        left = ", ".join(clean(name, at_most=40) for name in names)
        return (f"keys of {META} that are not read: {left}",) if left else ()

    def _decoded(self, name: str, most: int) -> Bytes:
        with open_picture(BytesIO(self.load(name)), ["WEBP"]) as image:
            if image.width * image.height > most:
                raise SceneError(
                    f"{self.path}: {clean(name, at_most=40)} has {image.width} x {image.height} "
                    f"pixels for {self.count} Gaussians",
                    fix=_BROKEN,
                )
            return np.asarray(image.convert("RGBA"))

    def _image(self, key: str, number: int = 0) -> Bytes:
        """(count, 4) bytes of one of a key's images."""
        name = str(self.meta[key]["files"][number])
        pixels = self._decoded(name, max(4 * self.count, _PIXELS)).reshape(-1, 4)
        if len(pixels) < self.count:
            raise SceneError(
                f"{self.path}: {clean(name, at_most=40)} has {len(pixels)} pixels for "
                f"{self.count} Gaussians",
                fix=_BROKEN,
            )
        return pixels[: self.count]

    def _between(self, key: str, share: NDArray[np.float64]) -> NDArray[np.float64]:
        least, most = (np.array(self.meta[key][bound], np.float64) for bound in ("mins", "maxs"))
        if least.shape != share.shape[1:] or most.shape != share.shape[1:]:
            raise SceneError(f"{self.path}: {key} has {least.size} bounds", fix=_BROKEN)
        span = most - least
        return least + np.where((span == 0) & (key == "means"), 1.0, span) * share

    def _codebook(self, key: str) -> NDArray[np.float32]:
        book = np.array(self.meta[key]["codebook"], np.float32)
        if book.shape != (256,):
            raise SceneError(f"{self.path}: codebook of {key} has {book.size} of 256", fix=_BROKEN)
        return book

    def _quats(self) -> NDArray[np.float64]:
        pixels = self._image("quats")
        others = (pixels[:, :3] / 255 - 0.5) * math.sqrt(2.0)
        rest = np.sqrt(np.maximum(0.0, 1.0 - (others * others).sum(axis=1)))
        quats = np.tile([1.0, 0.0, 0.0, 0.0], (self.count, 1))
        for largest in range(4):
            rows = np.flatnonzero(pixels[:, 3] == 252 + largest)
            places = [index for index in range(4) if index != largest]
            quats[rows, largest] = rest[rows]
            quats[rows[:, None], places] = others[rows]
        return quats

    def _harmonics(self) -> NDArray[np.float32]:
        rest = self.meta.get("shN")
        if not rest or (self.version == 2 and rest["bands"] == 0):
            return np.zeros((self.count, 0, 3), np.float32)
        palette = self._decoded(str(rest["files"][0]), _PIXELS)
        width = _WIDTHS.get(palette.shape[1])
        if width is None or (self.version == 2 and width != (3, 8, 15)[int(rest["bands"]) - 1]):
            raise SceneError(
                f"{self.path}: a palette of harmonics {palette.shape[1]} pixels wide", fix=_BROKEN
            )
        sets = palette[:, :, :3].reshape(-1, width, 3)
        pixels = self._image("shN", 1)
        labels = pixels[:, 0].astype(np.int64) | pixels[:, 1].astype(np.int64) << 8
        if labels.max(initial=0) >= len(sets):
            raise SceneError(
                f"{self.path}: a Gaussian names set {labels.max()} of {len(sets)}", fix=_BROKEN
            )
        if self.version == 2:
            values = self._codebook("shN")[sets]
        else:
            least, most = float(rest["mins"]), float(rest["maxs"])
            values = least + (most - least) * (sets / 255)
        return values[labels].astype(np.float32)


SOG = SplatFormat(
    name="sog",
    description="PlayCanvas's, versions 1 and 2; also its meta.json; only read",
    read=read_sog,
    sniff=lambda path, mark: path.name == META if mark[:4] != b"PK\x03\x04" else is_sog(path),
)
