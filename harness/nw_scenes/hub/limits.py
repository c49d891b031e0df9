"""How much may be fetched of an untrusted repository, checked before anything is asked for."""

from __future__ import annotations

FILES = 1000
"""Of one scene or policy. A scene folder has a handful, a policy's code some dozen."""

BYTES = 8 * 2**30
"""Of all files together, packed and unpacked. The largest published scene is said to have 4 GB."""

JSON = 16 * 2**20
"""Bytes of one answer of the hub, and of a refusal; a page of a thousand names has some hundred
thousand."""

PAGES = 64
"""Of a repository's listing."""

SECONDS = 120.0
"""That all answers may take together which say what a repository holds. A connection that is silent
counts as broken before."""

SLOWEST = 10_000
"""Bytes in a second that files come at on the average, at the least, after `SECONDS`."""

MANIFEST = 2**20
"""Of the list that is kept of what was fetched: names and digests of `FILES` files."""
