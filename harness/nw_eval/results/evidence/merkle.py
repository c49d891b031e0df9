"""The Merkle Tree Hash of RFC 6962, section 2.1: one digest for a list, whatever its length.

    MTH({})   = SHA-256()
    MTH({d})  = SHA-256(0x00 || d)
    MTH(D[n]) = SHA-256(0x01 || MTH(D[0:k]) || MTH(D[k:n])), k the largest power of two below n

The first byte keeps leaves and nodes apart: no list of other entries has the same digest, one whose
entries are the nodes of this one included.
"""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256


def leaf_hash(entry: bytes) -> bytes:
    """Return the hash of one entry of a list, 32 bytes."""
    return sha256(b"\x00" + entry).digest()


def root_of(leaves: Iterable[bytes]) -> bytes:
    """Return the hash of a list, 32 bytes.

    Args:
        leaves: the `leaf_hash` of every entry, in order.
    """
    trees = list(leaves)
    if not trees:
        return sha256().digest()
    while len(trees) > 1:  # All but the last one are of one size, a power of two.
        alone = trees[len(trees) & ~1 :]
        pairs = zip(trees[::2], trees[1::2], strict=False)
        trees = [sha256(b"\x01" + left + right).digest() for left, right in pairs]
        trees += alone
    return trees[0]
