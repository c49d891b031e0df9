"""What a Go2 looks like, from primitives: for overlays, logs and viewers. Nothing here collides."""

from __future__ import annotations

import math

from nw_eval.robots.spec import LEGS, Z_TO_X, Z_TO_Y, Shape

_LIGHT_GREY = (0.78, 0.79, 0.80, 1.0)
_DARK_GREY = (0.24, 0.25, 0.26, 1.0)
_BLACK = (0.07, 0.07, 0.08, 1.0)
_RUBBER = (0.13, 0.13, 0.14, 1.0)
_LENS = (0.22, 0.36, 0.55, 1.0)
_LAMP = (0.92, 0.94, 0.90, 1.0)


def go2_visuals() -> tuple[Shape, ...]:
    """Return the primitives, in body frames."""
    legs = [shape for leg in LEGS for shape in _leg(leg)]
    return (*_trunk(), *_head(), *legs)


def _trunk() -> list[Shape]:
    motors = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.045, 0.036),
            position=(0.165 * front, 0.0465 * left, 0.0),
            quat=Z_TO_X,
            rgba=_DARK_GREY,
        )
        for front in (1, -1)
        for left in (1, -1)
    ]
    return [
        Shape(body="trunk", kind="box", size=(0.165, 0.056, 0.042), rgba=_LIGHT_GREY),
        Shape(  # rounded back
            body="trunk",
            kind="ellipsoid",
            size=(0.200, 0.058, 0.034),
            position=(0.0, 0.0, 0.036),
            rgba=_LIGHT_GREY,
        ),
        Shape(  # battery, open at the flank
            body="trunk",
            kind="box",
            size=(0.095, 0.060, 0.024),
            position=(-0.005, 0.0, -0.012),
            rgba=_BLACK,
        ),
        Shape(  # belly
            body="trunk",
            kind="box",
            size=(0.150, 0.048, 0.007),
            position=(0.0, 0.0, -0.049),
            rgba=_BLACK,
        ),
        Shape(  # rear panel
            body="trunk",
            kind="box",
            size=(0.010, 0.040, 0.030),
            position=(-0.205, 0.0, 0.002),
            rgba=_DARK_GREY,
        ),
        *motors,
    ]


def _head() -> list[Shape]:
    return [
        Shape(
            body="trunk",
            kind="box",
            size=(0.050, 0.040, 0.034),
            position=(0.232, 0.0, 0.010),
            rgba=_LIGHT_GREY,
        ),
        Shape(  # flat face
            body="trunk",
            kind="ellipsoid",
            size=(0.034, 0.050, 0.046),
            position=(0.285, 0.0, 0.010),
            rgba=_BLACK,
        ),
        Shape(  # dome of the lidar under the chin
            body="trunk",
            kind="ellipsoid",
            size=(0.046, 0.046, 0.044),
            position=(0.293, 0.0, -0.060),
            rgba=_DARK_GREY,
        ),
        Shape(  # front camera
            body="trunk",
            kind="cylinder",
            size=(0.010, 0.004),
            position=(0.318, 0.0, 0.020),
            quat=Z_TO_X,
            rgba=_LENS,
        ),
        Shape(  # front lamp
            body="trunk",
            kind="box",
            size=(0.003, 0.014, 0.004),
            position=(0.318, 0.0, 0.038),
            rgba=_LAMP,
        ),
    ]


def _leg(leg: str) -> list[Shape]:
    left = 1.0 if leg[1] == "L" else -1.0
    hip, thigh, calf = f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"
    return [
        Shape(  # arm of the hip
            body=hip,
            kind="ellipsoid",
            size=(0.046, 0.040, 0.042),
            position=(0.0, 0.014 * left, 0.0),
            rgba=_DARK_GREY,
        ),
        Shape(  # motor of the thigh
            body=hip,
            kind="cylinder",
            size=(0.046, 0.022),
            position=(0.0, 0.062 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_DARK_GREY,
        ),
        Shape(body=thigh, kind="cylinder", size=(0.044, 0.018), quat=Z_TO_Y, rgba=_LIGHT_GREY),
        Shape(  # motor of the knee, in the thigh's head
            body=thigh,
            kind="cylinder",
            size=(0.028, 0.010),
            position=(0.0, 0.015 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_BLACK,
        ),
        Shape(
            body=thigh,
            kind="ellipsoid",
            size=(0.034, 0.018, 0.122),
            position=(0.002, 0.0, -0.094),
            rgba=_LIGHT_GREY,
        ),
        Shape(
            body=thigh,
            kind="box",
            size=(0.015, 0.013, 0.070),
            position=(0.0, 0.0, -0.135),
            rgba=_LIGHT_GREY,
        ),
        Shape(body=calf, kind="cylinder", size=(0.021, 0.016), quat=Z_TO_Y, rgba=_BLACK),
        Shape(
            body=calf,
            kind="cylinder",
            size=(0.0125, 0.060),
            position=(0.009, 0.0, -0.060),
            quat=(math.cos(0.1), 0.0, -math.sin(0.1), 0.0),
            rgba=_BLACK,
        ),
        Shape(
            body=calf,
            kind="cylinder",
            size=(0.0105, 0.045),
            position=(0.012, 0.0, -0.160),
            quat=(math.cos(0.1), 0.0, math.sin(0.1), 0.0),
            rgba=_BLACK,
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.023, 0.021, 0.022),
            position=(-0.002, 0.0, -0.213),
            rgba=_RUBBER,
        ),
    ]
