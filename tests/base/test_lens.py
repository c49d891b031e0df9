"""Lenses against the formulas of OpenCV's documentation, written here a second time."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.lens import Distortion, Intrinsics

# A D455's colour camera (factory calibration as published in ABC-iRobotics/Hand_Tools).
D455 = (-0.05574646681, 0.06033258925, -0.00097871176, -0.00084552983, -0.01606938667)
# As of an Azure Kinect's colour camera.
RATIONAL = (0.52, -2.72, 4e-4, -2e-4, 1.57, 0.4, -2.53, 1.49)
# An Intel T265 (its published factory calibration).
T265 = (-0.0046, 0.0397, -0.0374, 0.0062)
SIZE = {"width": 640, "height": 400, "fx": 315.0, "fy": 314.0, "cx": 314.6, "cy": 198.7}


def brown(a, b, k):
    """calib3d's `projectPoints`, term by term."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, 0, 0, 0, 0)[:8]
    r2 = a**2 + b**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a**2),
        b * radial + p1 * (r2 + 2 * b**2) + 2 * p2 * a * b,
    )


def fisheye(a, b, k):
    """fisheye's `projectPoints`."""
    r = math.hypot(a, b)
    t = math.atan(r)
    bent = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
    return (a * bent / r, b * bent / r) if r else (a, b)


@pytest.mark.parametrize(
    ("model", "coefficients", "formula"),
    [
        ("radial_tangential", D455, brown),
        ("radial_tangential", RATIONAL, brown),
        ("radial_tangential", (-0.25, 0.05, 1e-3, -2e-3), brown),
        ("fisheye", T265, fisheye),
    ],
)
def test_a_pixels_ray_projects_to_the_pixel_by_opencvs_formula(model, coefficients, formula):
    lens = Intrinsics(**SIZE, distortion={"model": model, "coefficients": coefficients})
    x, y = np.meshgrid(np.arange(0, 641, 40.0), np.arange(0, 401, 40.0))
    slopes = lens.slopes(x, y)
    for (a, b), u, v in zip(slopes.reshape(-1, 2), x.ravel(), y.ravel(), strict=True):
        bent_a, bent_b = formula(a, b, coefficients)
        assert 315.0 * bent_a + 314.6 == pytest.approx(u, abs=1e-6)
        assert 314.0 * bent_b + 198.7 == pytest.approx(v, abs=1e-6)


def test_without_coefficients_lines_stay_straight():
    x, y = np.meshgrid(np.arange(0.5, 640, 37), np.arange(0.5, 400, 29))
    zeros = Distortion(model="radial_tangential", coefficients=(0.0,) * 5)
    straight, bent = Intrinsics(**SIZE), Intrinsics(**SIZE, distortion=zeros)
    np.testing.assert_allclose(bent.slopes(x, y), straight.slopes(x, y), rtol=0, atol=1e-14)


def test_another_size_and_a_crop_look_the_same_way():
    lens = Intrinsics(**SIZE, distortion={"model": "fisheye", "coefficients": T265})
    x, y = np.array([12.0, 300.0]), np.array([390.0, 20.0])
    small = lens.resized(80, 45)
    np.testing.assert_allclose(small.slopes(x / 8, y * 45 / 400), lens.slopes(x, y), atol=1e-12)
    part = lens.cropped(left=10, top=5, right=30, bottom=1)
    assert (part.width, part.height) == (600, 394)
    np.testing.assert_allclose(part.slopes(x - 10, y - 5), lens.slopes(x, y), atol=1e-12)


def test_angles():
    """D435i's depth at 848 x 480: the data sheet says 58 degrees, give or take 3."""
    lens = Intrinsics(width=848, height=480, fx=424.0, fy=424.0, cx=424.0, cy=240.0)
    assert math.degrees(lens.fovy) == pytest.approx(58.0, abs=3.0)
    assert lens.widened(1.2).fovy == pytest.approx(1.2 * lens.fovy)
    assert Intrinsics.from_fovy(80, 45, 1.0).fovy == pytest.approx(1.0)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.1])
def test_a_wider_lens_sees_so_much_more_also_off_centre_and_through_a_fisheye(factor):
    fisheye = {"model": "fisheye", "coefficients": (0.0,) * 4}
    for changes in ({"cy": 60.0}, {"distortion": fisheye}, {"cy": 250.0, "distortion": fisheye}):
        lens = Intrinsics(**{**SIZE, **changes})
        assert lens.widened(factor).fovy == pytest.approx(factor * lens.fovy, rel=1e-6)


def test_a_lens_that_would_look_beyond_what_a_camera_can_see_is_refused():
    fisheye = {"model": "fisheye", "coefficients": (0.0,) * 4}
    wide = Intrinsics(width=160, height=90, fx=70, fy=70, cx=80, cy=45, distortion=fisheye)
    with pytest.raises(ValueError, match="no ray within 85 degrees of the axis"):
        wide.widened(1.5)
    pinhole = Intrinsics(width=160, height=90, fx=10, fy=10, cx=80, cy=45)
    with pytest.raises(ValueError, match="232 degrees from top to bottom are more than the 170"):
        pinhole.widened(1.5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cx": 700.0}, "cx 700 is outside of the image of 640 x 400"),
        ({"fx": 0.0}, "greater than or equal to 0.001"),
        (
            {"distortion": {"model": "radial_tangential", "coefficients": [-0.9, 0, 0, 0]}},
            r"no ray within 85 degrees of the axis meets pixel \(0, 0\)",
        ),
        (  # Numbers that overflow.
            {"distortion": {"model": "radial_tangential", "coefficients": [1e300, 1e300, 0, 0]}},
            "no ray within 85 degrees of the axis meets pixel",
        ),
        (
            {"distortion": {"model": "fisheye", "coefficients": [1e300, 0, 0, 0]}},
            "no ray within 85 degrees of the axis meets pixel",
        ),
        (
            {"distortion": {"model": "fisheye", "coefficients": [0.1] * 5}},
            "fisheye has 4 coefficients, not 5",
        ),
        (
            {"distortion": {"model": "radial_tangential", "coefficients": [0.1] * 6}},
            "radial_tangential has 4 or 5 or 8 coefficients, not 6",
        ),
    ],
)
def test_what_makes_no_lens_is_refused(changes, message):
    with pytest.raises(ValidationError, match=message):
        Intrinsics.model_validate(SIZE | changes)
