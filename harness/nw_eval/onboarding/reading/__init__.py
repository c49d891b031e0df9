"""What a checkpoint says of itself, and a first card for it.

`inspect_checkpoint` reads a file without running it; `write_card_draft` turns what it found into a
card whose comments say what is known, what is a guess, and what its author must check.
"""

from nw_eval.onboarding.drafting.draft import write_card_draft
from nw_eval.onboarding.reading.exporter import ExporterMetadata
from nw_eval.onboarding.reading.facts import ArrayFacts, CheckpointFacts, inspect_checkpoint

__all__ = [
    "ArrayFacts",
    "CheckpointFacts",
    "ExporterMetadata",
    "inspect_checkpoint",
    "write_card_draft",
]
