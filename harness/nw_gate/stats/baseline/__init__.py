"""Whether a candidate is worse than a baseline whose every trial is known: tests by betting."""
