"""Where shots were taken, in metres, by a phone's tracking or by GPS: scale, and perhaps up.

Cameras write GPS positions into photographs; `gps_positions` reads them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags

from nw_base.errors import UsageError
from nw_base.files.pictures import open_picture
from nw_scenes.scene import Vector
from nw_twin.calibrate.photographs import DAMAGE

Values = NDArray[np.float64]

_DRAWS = 300
_ROUNDS = 6
_MOST = 1e3
"""Relative: a scale that is known worse is as unknown."""
# WGS 84: equatorial radius in metres, first eccentricity squared.
_RADIUS, _ECCENTRICITY = 6378137.0, 6.69437999014e-3


@dataclass(frozen=True, kw_only=True)
class PositionFit:
    """The similarity from capture to the frame of known positions.

    Attributes:
        scale: metres in a unit of the capture.
        rotation: (3, 3) from capture to the positions' frame.
        off: median distance of a position from where the fit has it, metres.
        uncertain: standard deviation of the scale, relative.
        turned: standard deviation of the rotation about the axis that is known least, radians.
    """

    scale: float
    rotation: Values
    off: float
    uncertain: float
    turned: float


def fit_positions(
    centres: Values, metres: Values, rng: np.random.Generator, *, error: float = 0.0
) -> PositionFit:
    """Return the similarity that maps most centres to their positions.

    Umeyama's fit, to three of them at a time, and then to those that the best of these explains.

    Args:
        centres: (N, 3) of shots, in the capture's frame.
        metres: (N, 3) positions of the same shots.
        rng: of the draws.
        error: metres by which positions err together, as GPS does: no number of them averages it.

    Raises:
        UsageError: there are fewer than three, or all lie in one place.
    """
    apart = min(float(np.ptp(centres, axis=0).max()), float(np.ptp(metres, axis=0).max()))
    if len(centres) < 3 or apart <= 0:
        raise UsageError(
            f"{len(centres)} positions are known: they are too few or too close together",
            fix="give the positions of three shots or more, taken apart",
        )
    best: tuple[float, Values] | None = None
    for _ in range(_DRAWS):
        rows = rng.choice(len(centres), 3, replace=False)
        if np.ptp(centres[rows], axis=0).max() <= 0:
            continue
        off = _off(centres, metres, _umeyama(centres[rows], metres[rows], np.ones(3)))
        cost = float(np.median(off))
        if best is None or cost < best[0]:
            best = (cost, off)
    off = _off(centres, metres, _umeyama(centres, metres, np.ones(len(centres))))
    if best is not None and best[0] < float(np.median(off)):
        off = best[1]
    for _ in range(_ROUNDS):
        off = _off(centres, metres, _umeyama(centres, metres, _weights(off, apart)))
    weights = _weights(off, apart)
    scale, rotation, move = _umeyama(centres, metres, weights)
    off = _off(centres, metres, (scale, rotation, move))
    middle = np.einsum("n,ni->i", weights, centres) / weights.sum()
    spread_of = np.einsum("n,ni,nj->ij", weights, centres - middle, centres - middle)
    values = np.linalg.eigvalsh(spread_of) * scale**2  # Metres squared, summed.
    # A similarity takes seven of their numbers: three positions lie near any fit.
    free = max(3.0 * float(weights.sum()) / float(weights.max()) - 7.0, 1.0)
    each = float((weights * off**2).sum()) / float(weights.max()) / free
    wide = np.sqrt(12.0 * np.maximum(values, 0.0) / len(centres))  # As if evenly spread.
    return PositionFit(
        scale=scale,
        rotation=rotation,
        off=float(np.median(off)),
        uncertain=min(
            math.hypot(
                math.sqrt(each / max(float(values.sum()), 1e-300)),
                error / max(float(np.linalg.norm(wide)), 1e-300),
            ),
            _MOST,
        ),
        # A turn about the longest axis moves the points by what they extend across it.
        turned=math.hypot(
            math.sqrt(each / max(float(values[0] + values[1]), 1e-300)),
            error / max(float(np.linalg.norm(wide[:2])), 1e-300),
        ),
    )


def east_north_up(geodetic: Mapping[str, Vector]) -> dict[str, Vector]:
    """Return GPS positions in metres east, north and up of the first of them; z is up.

    Args:
        geodetic: latitude and longitude in degrees, height in metres (WGS 84), by name.
    """
    if not geodetic:
        return {}
    names = list(geodetic)
    degrees = np.array([geodetic[name] for name in names], dtype=np.float64)
    latitude, longitude = np.radians(degrees[:, 0]), np.radians(degrees[:, 1])
    normal = _RADIUS / np.sqrt(1.0 - _ECCENTRICITY * np.sin(latitude) ** 2)
    height = degrees[:, 2]
    earth = np.column_stack(
        [
            (normal + height) * np.cos(latitude) * np.cos(longitude),
            (normal + height) * np.cos(latitude) * np.sin(longitude),
            (normal * (1.0 - _ECCENTRICITY) + height) * np.sin(latitude),
        ]
    )
    sin_a, cos_a = math.sin(latitude[0]), math.cos(latitude[0])
    sin_o, cos_o = math.sin(longitude[0]), math.cos(longitude[0])
    to_local = np.array(
        [
            [-sin_o, cos_o, 0.0],
            [-sin_a * cos_o, -sin_a * sin_o, cos_a],
            [cos_a * cos_o, cos_a * sin_o, sin_a],
        ]
    )
    local = np.einsum("ij,nj->ni", to_local, earth - earth[0])
    return {name: (x, y, z) for name, (x, y, z) in zip(names, local.tolist(), strict=True)}


def _umeyama(source: Values, target: Values, weights: Values) -> tuple[float, Values, Values]:
    """Return scale, rotation and translation of the least-squares similarity (Umeyama, 1991)."""
    weights = weights / weights.sum()
    a, b = (np.einsum("n,ni->i", weights, x) for x in (source, target))
    covariance = np.einsum("n,ni,nj->ij", weights, target - b, source - a)
    u, stretch, v = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v))])
    rotation = u @ np.diag(signs) @ v
    variance = float((weights[:, None] * (source - a) ** 2).sum())
    scale = float((stretch * signs).sum()) / max(variance, 1e-300)
    return scale, rotation, b - scale * rotation @ a


def _weights(off: Values, apart: float) -> Values:
    """Return Tukey's weights of positions that are `off` by so many metres."""
    spread = max(float(np.median(off)), 1e-9 * apart)
    return np.clip(1.0 - (off / (4.0 * spread)) ** 2, 0.0, None) ** 2


def _off(centres: Values, metres: Values, fit: tuple[float, Values, Values]) -> Values:
    scale, rotation, move = fit
    return np.linalg.norm(scale * np.einsum("ij,nj->ni", rotation, centres) + move - metres, axis=1)


def gps_positions(photographs: Mapping[str, Path]) -> dict[str, Vector]:
    """Return where photographs were taken, metres east, north and up of the first that knows.

    Args:
        photographs: files as the camera left them, by the names of their shots. Those without a
            position, or damaged, are left out, and so are those without a height among others.
    """
    geodetic = {name: _geodetic(path) for name, path in photographs.items()}
    places = {name: place for name, place in geodetic.items() if place is not None}
    if any(math.isfinite(height) for *_, height in places.values()):
        known = {name: place for name, place in places.items() if math.isfinite(place[2])}
    else:
        known = {name: (place[0], place[1], 0.0) for name, place in places.items()}
    return east_north_up(known)


def _geodetic(path: Path) -> Vector | None:
    """Return latitude and longitude in degrees and height in metres, which is nan for none."""
    try:
        with warnings.catch_warnings(), open_picture(path) as image:
            warnings.simplefilter("ignore")  # Of damaged EXIF, which then says nothing.
            gps = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
        if gps.get(ExifTags.GPS.GPSStatus) == "V":  # Void: the last place that was known.
            return None
        datum = str(gps.get(ExifTags.GPS.GPSMapDatum, "WGS-84"))
        if "84" not in datum and "JGD" not in datum.upper():  # Others lie up to 500 m off.
            return None
        latitude = _degrees(gps[ExifTags.GPS.GPSLatitude])
        longitude = _degrees(gps[ExifTags.GPS.GPSLongitude])
        if gps.get(ExifTags.GPS.GPSLatitudeRef) == "S":
            latitude = -latitude
        if gps.get(ExifTags.GPS.GPSLongitudeRef) == "W":
            longitude = -longitude
        height = float(gps.get(ExifTags.GPS.GPSAltitude, math.nan))
        if gps.get(ExifTags.GPS.GPSAltitudeRef) in {b"\x01", 1}:
            height = -height
    except (*DAMAGE, ArithmeticError):
        return None
    place = (latitude, longitude, height)
    sensible = not math.isinf(height) and abs(latitude) <= 90 and abs(longitude) <= 180
    return place if sensible else None


def _degrees(parts: tuple[float, float, float]) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60.0 + seconds / 3600.0
