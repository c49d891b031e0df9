"""The built-in scenes: one entry of data each, by task."""

from __future__ import annotations

from nw_eval.scenes.entries.gaps import GAPS
from nw_eval.scenes.entries.hurdles import HURDLES
from nw_eval.scenes.entries.ramps import RAMPS
from nw_eval.scenes.entries.stairs import STAIRS
from nw_eval.scenes.entry import Entry

ENTRIES: tuple[Entry, ...] = (*HURDLES, *GAPS, *RAMPS, *STAIRS)
