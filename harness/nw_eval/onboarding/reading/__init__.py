"""What a checkpoint says of itself: `inspect_checkpoint` reads a file without running it."""

from nw_eval.onboarding.reading.exporter import ExporterMetadata
from nw_eval.onboarding.reading.facts import ArrayFacts, CheckpointFacts, inspect_checkpoint

__all__ = ["ArrayFacts", "CheckpointFacts", "ExporterMetadata", "inspect_checkpoint"]
