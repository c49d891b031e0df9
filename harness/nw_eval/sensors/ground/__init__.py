"""Sensors of the ground and of what stands on it."""
