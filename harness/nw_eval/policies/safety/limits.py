"""How much of this machine a checkpoint may take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FileLimits:
    """Bounds that are checked before memory is allocated.

    The largest policy of this field has some 100 MB; these leave room, and no more than that.
    """

    file_bytes: int = 2**30
    """Size of the file itself."""
    members: int = 20_000
    """Members of an archive."""
    unpacked_bytes: int = 2**30
    """Sum of the members' sizes after decompression."""
    compression: int = 200
    """Largest ratio of unpacked to packed size of a member; a bomb has 1000."""
    index_bytes: int = 2**24
    """The pickled index of a torch file, or the JSON of a graph."""
    code_bytes: int = 2**21
    """A script's code in all; that of large networks has a tenth of it."""
    tensors: int = 20_000
    """Number of tensors."""
    tensor_bytes: int = 2**30
    """Sum of the sizes of all tensors, counted one by one: views of one storage count each."""
    nodes: int = 20_000
    """Nodes of a graph, calls of functions written out."""
    depth: int = 64
    """Nesting of dicts and lists, and of brackets in code."""
