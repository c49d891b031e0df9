"""What a Go1 looks like, from primitives: for overlays, logs and viewers. Nothing here collides."""

from __future__ import annotations

from nw_eval.robots.spec import LEGS, Z_TO_X, Z_TO_Y, Shape

_SILVER = (0.80, 0.82, 0.84, 1.0)
_GRAPHITE = (0.30, 0.31, 0.33, 1.0)
_BLACK = (0.07, 0.07, 0.08, 1.0)
_RUBBER = (0.13, 0.13, 0.14, 1.0)
_LENS = (0.22, 0.36, 0.55, 1.0)
_LIGHT = (0.25, 0.80, 0.95, 1.0)


def go1_visuals() -> tuple[Shape, ...]:
    """Return the primitives, in body frames."""
    legs = [shape for leg in LEGS for shape in _leg(leg)]
    return (*_trunk(), *_head(), *legs)


def _trunk() -> list[Shape]:
    motors = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.043, 0.034),
            position=(0.158 * front, 0.04675 * left, 0.0),
            quat=Z_TO_X,
            rgba=_GRAPHITE,
        )
        for front in (1, -1)
        for left in (1, -1)
    ]
    return [
        Shape(body="trunk", kind="ellipsoid", size=(0.225, 0.058, 0.056), rgba=_SILVER),
        Shape(body="trunk", kind="box", size=(0.135, 0.057, 0.044), rgba=_SILVER),
        Shape(  # curved back
            body="trunk",
            kind="ellipsoid",
            size=(0.185, 0.055, 0.030),
            position=(0.0, 0.0, 0.040),
            rgba=_SILVER,
        ),
        Shape(  # battery bay, along the flanks
            body="trunk",
            kind="box",
            size=(0.110, 0.060, 0.020),
            position=(-0.005, 0.0, -0.018),
            rgba=_GRAPHITE,
        ),
        Shape(  # carrying rail on the back
            body="trunk",
            kind="box",
            size=(0.095, 0.018, 0.007),
            position=(-0.01, 0.0, 0.067),
            rgba=_BLACK,
        ),
        Shape(
            body="trunk",
            kind="box",
            size=(0.130, 0.046, 0.007),
            position=(0.0, 0.0, -0.051),
            rgba=_BLACK,
        ),
        Shape(  # rear panel
            body="trunk",
            kind="box",
            size=(0.008, 0.024, 0.024),
            position=(-0.219, 0.0, 0.004),
            rgba=_BLACK,
        ),
        # The four motors that swing the legs sideways close the trunk at both ends.
        *motors,
    ]


def _head() -> list[Shape]:
    eyes = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.010, 0.004),
            position=(0.3155, side * 0.019, 0.026),
            quat=Z_TO_X,
            rgba=_LENS,
        )
        for side in (1, -1)
    ]
    return [
        Shape(  # neck
            body="trunk",
            kind="box",
            size=(0.045, 0.034, 0.030),
            position=(0.200, 0.0, 0.018),
            rgba=_SILVER,
        ),
        Shape(
            body="trunk",
            kind="ellipsoid",
            size=(0.062, 0.058, 0.050),
            position=(0.246, 0.0, 0.020),
            rgba=_SILVER,
        ),
        Shape(  # glossy face
            body="trunk",
            kind="ellipsoid",
            size=(0.044, 0.051, 0.041),
            position=(0.276, 0.0, 0.017),
            rgba=_BLACK,
        ),
        Shape(  # light under the eyes
            body="trunk",
            kind="box",
            size=(0.004, 0.018, 0.0025),
            position=(0.3145, 0.0, 0.003),
            rgba=_LIGHT,
        ),
        *eyes,
    ]


def _leg(leg: str) -> list[Shape]:
    left = 1.0 if leg[1] == "L" else -1.0
    hip, thigh, calf = f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"
    return [
        Shape(  # arm of the hip
            body=hip,
            kind="ellipsoid",
            size=(0.044, 0.036, 0.040),
            position=(0.0, 0.012 * left, 0.0),
            rgba=_GRAPHITE,
        ),
        Shape(  # motor of the thigh
            body=hip,
            kind="cylinder",
            size=(0.046, 0.020),
            position=(0.0, 0.044 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_GRAPHITE,
        ),
        Shape(body=thigh, kind="cylinder", size=(0.043, 0.017), quat=Z_TO_Y, rgba=_SILVER),
        Shape(  # motor of the knee, in the thigh's head
            body=thigh,
            kind="cylinder",
            size=(0.027, 0.010),
            position=(0.0, 0.014 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_BLACK,
        ),
        Shape(
            body=thigh,
            kind="ellipsoid",
            size=(0.033, 0.016, 0.120),
            position=(0.004, 0.0, -0.092),
            rgba=_SILVER,
        ),
        Shape(
            body=thigh,
            kind="box",
            size=(0.014, 0.012, 0.070),
            position=(0.0, 0.0, -0.135),
            rgba=_SILVER,
        ),
        Shape(  # knee
            body=calf, kind="cylinder", size=(0.020, 0.016), quat=Z_TO_Y, rgba=_BLACK
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.017, 0.011, 0.070),
            position=(0.004, 0.0, -0.052),
            rgba=_BLACK,
        ),
        Shape(
            body=calf, kind="cylinder", size=(0.0095, 0.096), position=(0, 0, -0.110), rgba=_BLACK
        ),
        Shape(
            body=calf, kind="cylinder", size=(0.013, 0.014), position=(0, 0, -0.190), rgba=_SILVER
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.021, 0.019, 0.021),
            position=(0, 0, -0.213),
            rgba=_RUBBER,
        ),
    ]
