"""Whether a bank holds for a run, and what it then is to it."""
