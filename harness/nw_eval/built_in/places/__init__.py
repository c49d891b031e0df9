"""Kinds of places: one parametric builder each, composed on a stage from common furniture."""
