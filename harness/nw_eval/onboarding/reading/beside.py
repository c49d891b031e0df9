"""Files beside a checkpoint that may feed it, as comments of its draft."""

from __future__ import annotations

import hashlib
from pathlib import Path

from nw_eval.files.inside import what_is
from nw_eval.onboarding.reading.text import key, plain, quoted
from nw_eval.policies.bundle import SIZE_LIMIT

_ADAPTERS = {
    ".jit": "torchscript",
    ".onnx": "onnx",
    ".pt": "torchscript",
    ".pt2": "torch-export",
    ".pth": "torchscript",
}
_MOST = 8
"""Files that are named; a folder of saved steps of a training holds thousands."""


def files_beside(checkpoint: Path) -> str:
    """Return the lines under which other files would feed a checkpoint; empty if there are none.

    Nothing of them is read but their digest.
    """
    beside = sorted(checkpoint.parent.glob("*"))
    found = [path for path in beside if _may_feed(path, checkpoint)]
    if not found or len(found) > _MOST:
        return ""
    lines = [
        "",
        "# If a file beside it feeds it, say so, and name it in `inputs` as an observation:",
        "# networks:",
    ]
    for path in found:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        lines += [
            f"#   {key(path.stem)}:",
            f"#     adapter: {_ADAPTERS[path.suffix]}",
            f"#     checkpoint: {{file: {quoted(plain(path.name))}, sha256: {digest}}}",
            "#     inputs: []  # of the names under `observations`",
        ]
    return "\n".join(lines) + "\n"


def _may_feed(path: Path, checkpoint: Path) -> bool:
    try:
        return (
            path.suffix in _ADAPTERS
            and not path.is_symlink()
            and what_is(path) == "file"
            and not path.samefile(checkpoint)
            and path.stat().st_size <= SIZE_LIMIT
        )
    except OSError:  # It is gone, or not ours to read.
        return False
