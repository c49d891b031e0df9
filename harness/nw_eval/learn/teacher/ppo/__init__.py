"""Proximal policy optimisation, in one thread."""
