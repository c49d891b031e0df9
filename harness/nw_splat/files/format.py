"""A format of splat files, as one value that reads them and may write them.

Built-in formats are told by content, whatever a file is called. Those of installed packages
(entry-point group `nw_eval.splat_formats`) are told by the suffix of the file, which is the name of
the entry point, so that nothing of a package is imported for another file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nw_splat.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True)
class SplatFormat:
    """A format of splat files.

    Attributes:
        name: the suffix of its files without the dot, in small letters.
        description: the format in a few words.
        read: gets the path of a file and returns its Gaussians, in the axes of a 3DGS PLY file:
            x to the right, y down, z ahead. It raises `SceneError` for a file that is damaged, and
            takes memory in proportion to the file, whatever the file claims.
        write: gets a path, which it writes, and Gaussians; None = the format is only read.
        sniff: gets the path of a file and its first 16 bytes, and says whether the file is of this
            format; None = the suffix says it.

    Raises:
        ValueError: the name is no suffix.
    """

    name: str
    description: str
    read: Callable[[Path], Gaussians]
    write: Callable[[Path, Gaussians], None] | None = None
    sniff: Callable[[Path, bytes], bool] | None = None

    def __post_init__(self) -> None:
        if not (self.name.isascii() and self.name.isalnum() and self.name == self.name.lower()):
            raise ValueError(f"format {self.name!r}: a name has small letters and digits only")

    @property
    def suffix(self) -> str:
        """The suffix of its files, such as `.ply`."""
        return f".{self.name}"
