"""Opens pictures that may be anybody's: of the kinds that cameras write, and of no other."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING

from nw_base.files.inside import regular

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "AVIF", "HEIF")
"""Of photographs and masks, as Pillow names them."""

KINDS = "JPEG, PNG, TIFF, BMP, WebP, AVIF or HEIC"
"""The same for people."""


def open_picture(source: Path | IO[bytes], formats: Sequence[str] = FORMATS) -> Image:
    """Open a picture by what its bytes are, whatever its name says; its pixels are read later.

    Left to itself, Pillow tries every kind that it knows. It starts Ghostscript, a program that the
    file itself steers, for PostScript under any name.

    Args:
        source: a file, by its path or open for reading in binary.
        formats: kinds that are tried, as Pillow names them.

    Raises:
        PIL.UnidentifiedImageError: it is of no such kind, or damaged.
        OSError: it cannot be read, or a pipe, a device or a socket is there.
        Exception: whatever else Pillow raises at damaged files, such as ValueError, SyntaxError and
            PIL.Image.DecompressionBombError.
    """
    from PIL import Image

    if isinstance(source, Path):
        regular(source)
    Image.init()
    if "HEIF" in formats and "HEIF" not in Image.OPEN:
        with suppress(ImportError):  # Of the extra `twin`; whoever lacks it reads no HEIC.
            from pillow_heif import register_heif_opener

            register_heif_opener(thumbnails=False, depth_images=False, aux_images=False)
    # Older Pillows know no AVIF, and raise KeyError at a name that they do not know.
    known = [name for name in formats if name in Image.OPEN]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of damaged EXIF, which then says nothing.
        return Image.open(source, formats=known)
