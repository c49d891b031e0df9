"""A policy in a place, live: pushed, loaded, slowed and stood in the way of."""
