"""Gaussians from photographs whose cameras are known."""
