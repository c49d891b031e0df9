"""Sensors of the robot's own body."""
