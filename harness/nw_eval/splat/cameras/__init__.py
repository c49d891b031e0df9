"""Cameras: pose, lens, pixels, presets."""
