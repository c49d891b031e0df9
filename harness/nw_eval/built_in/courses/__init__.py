"""Obstacles and the trail over them, by task."""
