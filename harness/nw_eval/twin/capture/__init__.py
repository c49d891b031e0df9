"""Photographs whose cameras are known: what `calibrate` leaves and every later stage reads."""

from nw_eval.twin.capture.capture import Capture, PlacedShot
from nw_eval.twin.capture.file import read_capture, read_picture, write_capture

__all__ = ["Capture", "PlacedShot", "read_capture", "read_picture", "write_capture"]
