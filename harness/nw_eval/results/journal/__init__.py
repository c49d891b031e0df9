"""The journal of a run: one JSON line per finished trial, on disk before the next one starts.

    {"journal": 3, "suite_digest": ..., "policy_digest": ..., ..., "sum": ...}
    {"row": {...}, "sum": ...}
    {"row": {...}, "sum": ...}

A run that is killed at any moment loses the trials in flight and nothing else. A line that was torn
by the kill is dropped when the journal is read, and cut off before the next line is written. Every
line's sum covers the line and the sum before it (`seal`): a line that was changed, left out,
repeated or exchanged is an error, never another result.
"""

from nw_eval.results.journal.header import JournalHeader
from nw_eval.results.journal.journal import Journal, write_journal
from nw_eval.results.journal.read import JournalContents, has_begun, last_sum, read_journal

__all__ = [
    "Journal",
    "JournalContents",
    "JournalHeader",
    "has_begun",
    "last_sum",
    "read_journal",
    "write_journal",
]
