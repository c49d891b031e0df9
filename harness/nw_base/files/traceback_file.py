"""Where the traceback of an unexpected exception is kept: in a file, never on a screen."""

from __future__ import annotations

import os
import traceback
from contextlib import suppress
from pathlib import Path
from tempfile import mkstemp
from types import TracebackType

from nw_base.errors import NwEvalError

NAME = "traceback.txt"
"""Its name in the folder of a run."""

_ATTRIBUTE = "nw_eval_traceback_file"


class TracebackIn:
    """A `with` block whose unforeseen exceptions leave their traceback in a folder, and go on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is not None and not isinstance(error, NwEvalError | KeyboardInterrupt):
            keep_traceback(error, self._folder)


def keep_traceback(error: BaseException, folder: Path | None = None) -> Path | None:
    """Write an exception's traceback to a file, once.

    Args:
        error: caught.
        folder: where `traceback.txt` goes; without one, and if it cannot be written there, it is a
            private file of the system's temporary folder.

    Returns:
        The file; None if there is room nowhere.
    """
    kept: Path | None = getattr(error, _ATTRIBUTE, None)
    if kept is None:
        with suppress(Exception):  # A hostile `__str__`, or no memory: the error itself counts.
            text = "".join(traceback.format_exception(error))
            kept = _written(text, folder)
            setattr(error, _ATTRIBUTE, kept)
    return kept


def _written(text: str, folder: Path | None) -> Path | None:
    if folder is not None:
        with suppress(OSError):
            path = folder / NAME
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
            return path
    with suppress(OSError):
        handle, name = mkstemp(prefix="nw-eval-", suffix=f"-{NAME}")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
        return Path(name)
    return None
