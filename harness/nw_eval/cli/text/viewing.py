"""What was written of a log for another program, and how that opens it."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.plural import plural

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.viewing.recording.track import WrittenRecording


def layout_lines(log: Path, layout: Path) -> str:
    """Return where Rerun's layout is, and the commands that show the log by it."""
    converted = layout.with_suffix(".rrd")
    return (
        f"{clean(layout)}\n"
        f"rerun mcap convert --application-id nw-eval {_quoted(log)} -o {_quoted(converted)}\n"
        f"rerun {_quoted(layout)} {_quoted(converted)}"
    )


def recording_line(written: WrittenRecording) -> str:
    """Return what a recording is, and what it lacks."""
    splat = plural(written.gaussians, "Gaussian") if written.gaussians else "no splat"
    lack = f" ({clean(written.no_splat)})" if written.no_splat else ""
    return f"{clean(written.file)}: {written.bytes / 1e6:.1f} MB, {splat}{lack}"


def _quoted(path: Path) -> str:
    return clean(quote(str(path)))
