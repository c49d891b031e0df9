"""Cards that differ from a given one in one respect."""
