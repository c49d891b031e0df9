"""Kinds of places: one parametric builder each, composed from common furniture."""
