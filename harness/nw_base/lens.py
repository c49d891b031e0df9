"""Lenses: where the pixels of a camera look.

Camera axes are OpenCV's (x right, y down, z ahead). The centre of the first pixel is at (0.5, 0.5);
OpenCV and ROS put it at (0, 0), so that their `cx` and `cy` are half a pixel less.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_base import same_bits

Array = NDArray[np.float64]

WIDEST = math.radians(85.0)
"""How far from the axis a pixel may look, rad: there depth along the axis and splats end."""

ShutterTime = Annotated[float, Field(ge=0.0, le=0.1, allow_inf_nan=False)]
"""Of `readout` and `exposure` of a camera, s."""

_COUNTS = {"radial_tangential": (4, 5, 8), "fisheye": (4,)}
_STEPS = 50  # of Newton's method; it takes 4 to 8
_EXACT = 1e-9  # of a slope


class _Part(BaseModel, frozen=True):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Distortion(_Part, frozen=True):
    """How a lens bends straight lines, by OpenCV's formulas.

    `radial_tangential` is OpenCV's own model (Brown-Conrady; `plumb_bob` and `rational_polynomial`
    in ROS), with a = x / z, b = y / z and r2 = a^2 + b^2:

        radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
        a' = a radial + 2 p1 a b + p2 (r2 + 2 a^2),  b' = b radial + p1 (r2 + 2 b^2) + 2 p2 a b

    `fisheye` is that of `cv2.fisheye` (Kannala-Brandt; `equidistant` in ROS), with the angle t from
    the axis: (a', b') = (a, b) / r * t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).
    A pixel is (fx a' + cx, fy b' + cy). Source: OpenCV, modules calib3d and fisheye.
    """

    model: Literal["radial_tangential", "fisheye"]
    """Whose formulas."""
    coefficients: Annotated[tuple[float, ...], Field(min_length=4, max_length=8)]
    """`radial_tangential`: k1 k2 p1 p2, then k3, then k4 k5 k6. `fisheye`: k1 k2 k3 k4."""

    @model_validator(mode="after")
    def _counted(self) -> Self:
        counts = _COUNTS[self.model]
        if len(self.coefficients) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(
                f"{self.model} has {wanted} coefficients, not {len(self.coefficients)}; "
                "give zeros for those that the calibration leaves out"
            )
        return self

    def straight(self, seen: Array) -> Array:
        """Return the slopes (..., 2) of rays that meet the image there (..., 2), for fx = fy = 1.

        NaN where there is none: where the polynomial turns back, or beyond `WIDEST`.
        """
        # Coefficients may be anything: what overflows has no ray.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if self.model == "fisheye":
                return self._straight_fisheye(seen)
            return self._straight_brown(seen)

    def _polar(self, t: Array) -> tuple[Array, Array]:
        """Return t (1 + k1 t^2 + ...) of angles, and its derivative."""
        k1, k2, k3, k4 = self.coefficients
        t2 = t * t
        bent = t * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        rate = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        return bent, rate

    def _straight_fisheye(self, seen: Array) -> Array:
        r = np.hypot(seen[..., 0], seen[..., 1])
        t = np.minimum(r, WIDEST)
        for _ in range(_STEPS):
            bent, rate = self._polar(t)
            t = np.clip(t - (bent - r) / np.where(rate > 1e-3, rate, 1e-3), 0.0, 1.01 * WIDEST)
        bent, rate = self._polar(t)
        good = (np.abs(bent - r) < _EXACT) & (rate > 0.0) & (t <= WIDEST)
        scale = np.where(r > 0.0, same_bits.tan(t) / _sure(r), 1.0)
        return np.where(good[..., None], seen * scale[..., None], np.nan)

    def _brown(self, a: Array, b: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Return what (a, b) become, (..., 2), and the partials (aa, ab, bb); ab is ba."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, 0.0, 0.0, 0.0, 0.0)[:8]
        r2 = a * a + b * b
        above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = above / below
        rate = (
            k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))
        ) / below
        bent = np.stack(
            [
                a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a),
                b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b,
            ],
            axis=-1,
        )
        partials = (
            radial + 2.0 * a * a * rate + 2.0 * p1 * b + 6.0 * p2 * a,
            2.0 * a * b * rate + 2.0 * p1 * a + 2.0 * p2 * b,
            radial + 2.0 * b * b * rate + 6.0 * p1 * b + 2.0 * p2 * a,
        )
        return bent, partials

    def _straight_brown(self, seen: Array) -> Array:
        # From the axis outwards, so that Newton's method stays on the branch through the axis.
        a, b = np.zeros(seen.shape[:-1]), np.zeros(seen.shape[:-1])
        good = np.ones(a.shape, dtype=np.bool_)
        for share in np.linspace(0.125, 1.0, 8):
            for _ in range(_STEPS // 8):
                bent, (aa, ab, bb) = self._brown(a, b)
                off_a, off_b = (bent[..., i] - share * seen[..., i] for i in (0, 1))
                det = aa * bb - ab * ab
                good &= (det > 0.0) & (aa > 0.0)
                det = np.where(good, det, 1.0)
                a = np.where(good, a - (bb * off_a - ab * off_b) / det, a)
                b = np.where(good, b - (aa * off_b - ab * off_a) / det, b)
        bent, (aa, ab, bb) = self._brown(a, b)
        good &= (np.abs(bent - seen).max(axis=-1) < _EXACT) & (aa * bb - ab * ab > 0.0)
        good &= np.hypot(a, b) <= math.tan(WIDEST)
        return np.where(good[..., None], np.stack([a, b], axis=-1), np.nan)


class Intrinsics(_Part, frozen=True):
    """What a camera sees: the size of its image, and where its pixels look."""

    width: Annotated[int, Field(ge=1, le=16384)]
    """Pixels of the image that the numbers are of. Images of another size are the same view."""
    height: Annotated[int, Field(ge=1, le=16384)]
    """Pixels, as `width`."""
    fx: Annotated[float, Field(ge=1e-3, le=1e6)]
    """Focal length across, pixels."""
    fy: Annotated[float, Field(ge=1e-3, le=1e6)]
    """Focal length down, pixels."""
    cx: float
    """Column of the optical axis, pixels from the image's left border."""
    cy: float
    """Row of the optical axis, pixels from the upper border."""
    distortion: Distortion | None = None
    """None = straight lines stay straight."""

    @model_validator(mode="after")
    def _sees(self) -> Self:
        """Refuse numbers that are slips: an axis outside of the image, pixels without a ray."""
        for name, at, side in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not 0.0 < at < side:
                raise ValueError(
                    f"{name} {at:g} is outside of the image of {self.width} x {self.height}; give "
                    "the pixel that the optical axis meets, for images of that size"
                )
        if self.distortion is not None:
            x, y = np.meshgrid(np.linspace(0.0, self.width, 65), np.linspace(0.0, self.height, 65))
            blind = np.isnan(self.slopes(x, y)[..., 0])
            if blind.any():
                row, column = (int(i[0]) for i in np.nonzero(blind))
                raise ValueError(
                    f"by this distortion no ray within {math.degrees(WIDEST):.0f} degrees of the "
                    f"axis meets pixel ({x[row, column]:.0f}, {y[row, column]:.0f}); check the "
                    "coefficients, or give the width, height, cx and cy of the image's middle"
                )
        return self

    @classmethod
    def from_fovy(cls, width: int, height: int, fovy: float) -> Self:
        """Return those of square pixels and a centred axis; `fovy`, rad, is the vertical angle."""
        focal = 0.5 * height / math.tan(0.5 * fovy)
        return cls.model_construct(
            width=width, height=height, fx=focal, fy=focal, cx=0.5 * width, cy=0.5 * height
        )

    @property
    def fovy(self) -> float:
        """The vertical angle through the optical axis, rad."""
        if self.distortion is None:
            ends = (self.cy / self.fy, (self.height - self.cy) / self.fy)
        else:
            slopes = self.slopes(np.full(2, self.cx), np.array([0.0, float(self.height)]))
            ends = (-float(slopes[0, 1]), float(slopes[1, 1]))
        return math.atan(ends[0]) + math.atan(ends[1])

    def slopes(self, x: NDArray[np.floating[Any]], y: NDArray[np.floating[Any]]) -> Array:
        """Return x / z and y / z (..., 2) of the rays through points (...) of the image, pixels."""
        seen = np.stack([(x - self.cx) / self.fx, (y - self.cy) / self.fy], axis=-1).astype(float)
        return seen if self.distortion is None else self.distortion.straight(seen)

    def grid(self, x: NDArray[Any], y: NDArray[Any]) -> Array:
        """Return `slopes` (rows, columns, 2) of columns at x (columns,) and rows at y (rows,)."""
        columns, rows = np.broadcast_arrays(x, y[:, np.newaxis])
        return self.slopes(columns, rows)

    def resized(self, width: int, height: int) -> Self:
        """Return those of the same view in an image of another size."""
        across, down = width / self.width, height / self.height
        return self.model_copy(
            update={
                "width": width,
                "height": height,
                "fx": self.fx * across,
                "fy": self.fy * down,
                "cx": self.cx * across,
                "cy": self.cy * down,
            }
        )

    def cropped(self, *, left: int, top: int, right: int, bottom: int) -> Self:
        """Return those of an image without some columns and rows at its borders."""
        return self.model_copy(
            update={
                "width": self.width - left - right,
                "height": self.height - top - bottom,
                "cx": self.cx - left,
                "cy": self.cy - top,
            }
        )

    def widened(self, factor: float) -> Self:
        """Return those of a lens with another focal length, for a vertical angle times `factor`.

        Raises:
            ValueError: a pixel of it would look farther from the axis than `WIDEST`.
        """
        wanted = factor * self.fovy
        if not 0.0 < wanted <= 2.0 * WIDEST:
            raise ValueError(
                f"{math.degrees(wanted):.0f} degrees from top to bottom are more than the "
                f"{math.degrees(2.0 * WIDEST):.0f} that a camera can see"
            )
        zoom = math.tan(0.5 * self.fovy) / math.tan(0.5 * wanted)  # Of a centred pinhole.
        if self.distortion is not None or 2.0 * self.cy != self.height:
            low, high = 1e-3 * zoom, 1e3 * zoom
            for _ in range(100):
                zoom = math.sqrt(low * high)
                angle = self._zoomed(zoom).fovy
                # No ray (NaN) is as too wide an angle.
                low, high = (low, zoom) if angle <= wanted else (zoom, high)
        try:
            return type(self).model_validate(self._zoomed(zoom).model_dump())
        except ValidationError as error:
            raise ValueError(error.errors()[0]["msg"].removeprefix("Value error, ")) from None

    def _zoomed(self, zoom: float) -> Self:
        return self.model_copy(update={"fx": self.fx * zoom, "fy": self.fy * zoom})


def _sure(values: Array) -> Array:
    return np.maximum(values, 1e-300)
