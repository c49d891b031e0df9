"""From photographs to a place: what makes twins of real places. Nothing below knows this wing."""
