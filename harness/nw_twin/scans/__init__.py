"""Scans that others made, to scenes; and levelling, turning over and scaling a scene."""
