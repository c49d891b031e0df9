"""Sensors that give images."""
