"""Functions that give the same bits on every processor.

NumPy has `exp`, `log`, `arctan2` and others twice or more, by instruction set, and OpenBLAS has a
kernel for each kind of processor: inverses, scalar products and some products of matrices end in
other digits there. What is here is made of single IEEE operations in one order, and of `rint`,
`frexp` and `ldexp`, which are exact. Errors are a few units in the last place at most; `power` has
those of its logarithm.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Floating = TypeVar("Floating", bound=np.floating)

_LN2 = float.fromhex("0x1.62e42fefa39efp-1")
# The first part has 21 trailing zeros: its products with exponents are exact.
_LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
# The same of pi / 2: 33 bits, 33 bits, and the rest.
_QUARTER = tuple(
    map(float.fromhex, ("0x1.921fb544p+0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69"))
)
_FACTORIALS = list(accumulate(range(1, 20), lambda product, k: product * k, initial=1))
_EXP = [1.0 / _FACTORIALS[k] for k in range(14)]
_SIN = [(-1.0) ** k / _FACTORIALS[2 * k + 1] for k in range(9)]
_COS = [(-1.0) ** k / _FACTORIALS[2 * k] for k in range(10)]
_ARTANH = [1.0 / (2 * k + 1) for k in range(1, 12)]
_ATAN = [(-1.0) ** k / (2 * k + 1) for k in range(22)]
_ATAN_DOWN = _ATAN[-2::-1]
_TAN_EIGHTH = math.sqrt(2.0) - 1.0


def _polynomial(coefficients: list[float], x: Array) -> Array:
    total = np.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total *= x
        total += coefficient
    return total


def exp(x: NDArray[Floating]) -> NDArray[Floating]:
    """Return e^x; of float32, the nearest float32."""
    with np.errstate(all="ignore"):
        given = np.clip(np.asarray(x, np.float64), -800.0, 800.0)
        whole = np.rint(given * (1.0 / _LN2))
        rest = (given - whole * _LN2_HIGH) - whole * _LN2_LOW
        power = np.where(np.isnan(whole), 0.0, whole).astype(np.int32)
        return np.ldexp(_polynomial(_EXP, rest), power).astype(x.dtype)


def _split_log(x: ArrayLike) -> tuple[Array, Array, Array]:
    """Return exponent, 2 s and the rest of log(mantissa); x is above 0."""
    mantissa, exponent = np.frexp(np.asarray(x, np.float64))
    is_low = mantissa < math.sqrt(0.5)
    mantissa = np.where(is_low, 2.0 * mantissa, mantissa)
    share = (mantissa - 1.0) / (mantissa + 1.0)
    square = share * share
    rest = 2.0 * share * square * _polynomial(_ARTANH, square)
    return (exponent - is_low).astype(np.float64), 2.0 * share, rest


def _of_logarithm(x: ArrayLike, value: Array) -> Array:
    given = np.asarray(x, np.float64)
    value = np.where(given == 0.0, -np.inf, np.where(given < 0.0, np.nan, value))
    return np.where(np.isfinite(given) | np.isneginf(given), value, given)


def log(x: NDArray[Floating]) -> NDArray[Floating]:
    """Return the natural logarithm; of float32, the nearest float32."""
    with np.errstate(all="ignore"):
        exponent, first, rest = _split_log(x)
        value = exponent * _LN2_HIGH + (first + (rest + exponent * _LN2_LOW))
        return _of_logarithm(x, value).astype(x.dtype)


def log2(x: NDArray[Floating]) -> NDArray[Floating]:
    """Return the logarithm to base 2, exact for powers of 2; of float32, the nearest float32."""
    with np.errstate(all="ignore"):
        exponent, first, rest = _split_log(x)
        return _of_logarithm(x, exponent + (first + rest) * (1.0 / _LN2)).astype(x.dtype)


def power(x: NDArray[Floating], exponent: float) -> NDArray[Floating]:
    """Return x to the power of an exponent above 0; NaN for negative x."""
    with np.errstate(all="ignore"):
        return exp(exponent * log(x.astype(np.float64))).astype(x.dtype)


def tan(x: Array) -> Array:
    """Return the tangent of angles of a few turns."""
    quarters = np.rint(x * (2.0 / math.pi))
    rest = x
    for part in _QUARTER:
        rest = rest - quarters * part
    square = rest * rest
    sine, cosine = rest * _polynomial(_SIN, square), _polynomial(_COS, square)
    is_odd = np.abs(quarters) % 2.0 == 1.0
    return np.where(is_odd, -cosine, sine) / np.where(is_odd, sine, cosine)


def _angle(y: Array, x: Array) -> Array:
    high, wide = np.abs(y), np.abs(x)
    is_steep = high > wide
    share = np.where(is_steep, wide, high) / np.where(is_steep, high, wide)
    share = np.where((high == 0.0) & (wide == 0.0), 0.0, share)
    share = np.where(np.isinf(high) & np.isinf(wide), 1.0, share)
    beyond = share > _TAN_EIGHTH
    share = np.where(beyond, (share - 1.0) / (share + 1.0), share)
    angle = share * _polynomial(_ATAN, share * share)
    angle = np.where(beyond, math.pi / 4 + angle, angle)
    angle = np.where(is_steep, math.pi / 2 - angle, angle)
    return np.copysign(np.where(np.signbit(x), math.pi - angle, angle), y)


def _angle_of_one(y: float, x: float) -> float:
    """Return what `_angle` does of finite numbers, sooner."""
    high, wide = abs(y), abs(x)
    is_steep = high > wide
    share = (wide / high if is_steep else high / wide) if high or wide else 0.0
    beyond = share > _TAN_EIGHTH
    if beyond:
        share = (share - 1.0) / (share + 1.0)
    square, total = share * share, _ATAN[-1]
    for coefficient in _ATAN_DOWN:
        total = total * square + coefficient
    angle = math.pi / 4 + share * total if beyond else share * total
    if is_steep:
        angle = math.pi / 2 - angle
    if math.copysign(1.0, x) < 0.0:
        angle = math.pi - angle
    return math.copysign(angle, y)


def arctan2(y: ArrayLike, x: ArrayLike) -> Array:
    """Return the angle of points, rad in [-pi, pi]."""
    if isinstance(y, float) and isinstance(x, float) and math.isfinite(y) and math.isfinite(x):
        return np.array(_angle_of_one(float(y), float(x)))
    with np.errstate(all="ignore"):
        return _angle(*np.broadcast_arrays(np.asarray(y, np.float64), np.asarray(x, np.float64)))


def arcsin(x: ArrayLike) -> Array:
    """Return the arc sine of -1 to 1, rad."""
    if isinstance(x, float) and abs(x) <= 1.0:
        return arctan2(x, math.sqrt((1.0 - x) * (1.0 + x)))
    given = np.asarray(x, np.float64)
    return arctan2(given, np.sqrt((1.0 - given) * (1.0 + given)))


def dot(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors."""
    return float((a * b).sum())


def length(a: ArrayLike) -> float:
    """Return the length of a vector."""
    vector = np.asarray(a, np.float64)
    return math.sqrt(dot(vector, vector))


def product(v: Array, R: Array) -> Array:
    """Return v @ R of a vector (n,) and a matrix (n, m): R.T @ v."""
    return (v[:, np.newaxis] * R).sum(axis=0)


def inverse(T: Array) -> Array:
    """Return the inverse of an affine transform (4, 4), whose last row is 0 0 0 1.

    Raises:
        numpy.linalg.LinAlgError: it has none.
    """
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = T.tolist()
    assert last == [0.0, 0.0, 0.0, 1.0], f"no affine transform: last row {last}"
    # Columns of the adjugate are cross products of rows.
    rows = (
        (e * i - f * h, c * h - b * i, b * f - c * e),
        (f * g - d * i, a * i - c * g, c * d - a * f),
        (d * h - e * g, b * g - a * h, a * e - b * d),
    )
    determinant = a * rows[0][0] + b * rows[1][0] + c * rows[2][0]
    if determinant == 0.0:
        raise np.linalg.LinAlgError("Singular matrix")
    turned = [[each / determinant for each in row] for row in rows]
    moved = [-(p * x + q * y + r * z) for p, q, r in turned]
    return np.array([[*row, to] for row, to in zip(turned, moved, strict=True)] + [last])
