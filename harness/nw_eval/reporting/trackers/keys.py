"""Names of strangers as keys that every tracker takes, each name its own.

W&B, MLflow and TensorBoard forbid different characters and lengths; letters, digits, `_`, `-`, `.`
and slashes between them are fine in all. MLflow keeps a metric as a file of its key's path, so that
no key may be the folder of another.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from hashlib import sha256
from pathlib import PurePosixPath

_LONGEST = 100
"""Characters of a key, before its mark: MLflow takes 250 in all, of which others stand before."""
_MARK = re.compile(r"-[0-9a-f]{12}$")


def key_of(name: str) -> str:
    """Return a name as a key of one part or more, between slashes.

    A name that cannot stay as it is gets a mark of its own behind what is left of it; a name that
    ends as if it had one gets one too. So no two names share a key.
    """
    parts = (re.sub(r"[^A-Za-z0-9_.-]+", "_", part).strip(".") for part in name.split("/"))
    key = "/".join(part for part in parts if part)[:_LONGEST].rstrip("/.")
    is_plain = key and key == name and not _MARK.search(key)
    return key if is_plain else _marked(key, name)


def keys_of(names: Iterable[str]) -> dict[str, str]:
    """Return the key of each name; none is the folder of another."""
    keys = {name: key_of(name) for name in names}
    folders = {str(folder) for key in keys.values() for folder in PurePosixPath(key).parents}
    return {
        name: _marked(key, name) if key in folders else key for name, key in sorted(keys.items())
    }


def _marked(key: str, name: str) -> str:
    digest = sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:12]
    return f"{key or 'unnamed'}-{digest}"
