"""Networks that feed a checkpoint."""
