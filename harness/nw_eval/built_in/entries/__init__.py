"""The built-in scenes: one entry of data each, by task."""

from __future__ import annotations

from nw_eval.built_in.entries.gaps import GAPS
from nw_eval.built_in.entries.hurdles import HURDLES
from nw_eval.built_in.entries.ramps import RAMPS
from nw_eval.built_in.entries.stairs import STAIRS
from nw_eval.built_in.entry import Entry

ENTRIES: tuple[Entry, ...] = (*HURDLES, *GAPS, *RAMPS, *STAIRS)
