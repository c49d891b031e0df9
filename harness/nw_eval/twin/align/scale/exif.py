"""Where a photograph was taken, as its camera wrote into it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import ExifTags, UnidentifiedImageError

from nw_eval.files.pictures import open_picture
from nw_eval.scenes.scene import Vector
from nw_eval.twin.align.scale.positions import east_north_up

_DAMAGE = (OSError, UnidentifiedImageError, ValueError, TypeError, LookupError, SyntaxError)


def gps_positions(photographs: Mapping[str, Path]) -> dict[str, Vector]:
    """Return where photographs were taken, metres east, north and up of the first that knows.

    Args:
        photographs: files as the camera left them, by the names of their shots. Those without a
            place, or damaged, are left out.
    """
    found = {name: _geodetic(path) for name, path in photographs.items()}
    return east_north_up({name: place for name, place in found.items() if place is not None})


def _geodetic(path: Path) -> Vector | None:
    """Return latitude and longitude in degrees and height in metres."""
    try:
        with open_picture(path) as image:
            gps = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
        latitude = _degrees(gps[ExifTags.GPS.GPSLatitude])
        longitude = _degrees(gps[ExifTags.GPS.GPSLongitude])
        if gps.get(ExifTags.GPS.GPSLatitudeRef) == "S":
            latitude = -latitude
        if gps.get(ExifTags.GPS.GPSLongitudeRef) == "W":
            longitude = -longitude
        height = float(gps.get(ExifTags.GPS.GPSAltitude, 0.0))
        if gps.get(ExifTags.GPS.GPSAltitudeRef) in {b"\x01", 1}:
            height = -height
    except (*_DAMAGE, ArithmeticError):
        return None
    place = (latitude, longitude, height)
    sensible = np.isfinite(place).all() and abs(latitude) <= 90 and abs(longitude) <= 180
    return place if sensible else None


def _degrees(parts: tuple[float, float, float]) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60.0 + seconds / 3600.0
