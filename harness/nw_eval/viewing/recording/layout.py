"""Writes Rerun's layout of one log to a file."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import UsageError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.rollout.mcap.reader import LogReader
from nw_eval.viewing.recording.blueprint import save_layout
from nw_eval.viewing.recording.sdk import rerun_sdk
from nw_eval.viewing.shown import shown_in_log

SUFFIX = ".rbl"


def write_layout(log: Path, out: Path) -> Path:
    """Write how Rerun is to show a log that it has converted itself; return `out`.

    Raises:
        PrerequisiteError: Rerun is not installed.
        UsageError: `out` has another suffix than `.rbl`.
        StoreError: the log cannot be read or is damaged, or the layout not written.
    """
    rerun_sdk()
    if out.suffix.lower() != SUFFIX:
        raise UsageError(f"{out}: Rerun knows its layouts by {SUFFIX}", fix="name it so")
    shown = shown_in_log(LogReader(log))
    with atomic_path(followed(out)) as temporary:
        save_layout(shown, temporary)
    return out
