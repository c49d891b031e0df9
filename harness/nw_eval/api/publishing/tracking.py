"""A judged run on the run of its checkpoint, in a tracker of experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport
    from nw_eval.words import Tracker


def track_run(judged: RunReport, tracker: Tracker) -> None:
    """Show a run in a tracker, with pages and clips that were written of this verdict.

    Raises:
        Exception: whatever the tracker's library raises.
    """
    from nw_eval.reporting.trackers.tracked import track, tracked_run

    pages = tuple(page for page in (judged.page, judged.html) if page is not None)
    clips = () if judged.evidence is None else judged.evidence.clips
    track(tracker, tracked_run(judged.info, judged.verdict, judged.folder, pages, clips))
