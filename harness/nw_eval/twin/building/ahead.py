"""How long a stage will take, and how much memory, said before it begins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from nw_eval.twin.building.folder import BuildFolder
from nw_eval.twin.building.settings import BuildSettings
from nw_eval.twin.capture import Capture, read_capture

_SWEEP_S = 6.0 / (640 * 360 * 128 * 5)
"""Seconds of one core for a pixel, a plane and a neighbour of the sweep, matching included."""
_PLANES_S = 3.0 / (640 * 360 * 5)
"""Seconds of one core for a pixel and a neighbour, of giving each pixel its plane."""
_SWEEP_BYTES = 14
"""Of a pixel and a plane: costs, their sums over four directions, and the best so far."""
_STEP_S = (0.02, 0.7e-6, 0.9e-6)
"""Seconds of one core for a step of training: at least, for a Gaussian, and for a pixel."""
_GAUSSIAN_BYTES = 1500
"""Of a Gaussian in training: values, gradients, moments, and room to grow."""


def say_ahead(
    stage: Literal["reconstruct", "splat"],
    folder: BuildFolder,
    settings: BuildSettings,
    say: Callable[[str], None],
) -> None:
    """Say what a stage will take: by what was measured on a core of 2026, to a factor of two.

    Args:
        stage: which.
        folder: with the capture.
        settings: of the build.
        say: takes a line for people.

    Raises:
        SceneError: the capture cannot be read.
    """
    capture = read_capture(folder.capture)
    if stage == "reconstruct":
        seconds, memory = _sweep(capture, settings)
    else:
        seconds, memory = _training(capture, settings)
    minutes = max(1, round(seconds / min(settings.threads, 2) / 60))
    say(
        f"{stage}: {len(capture.shots)} photographs, about {minutes} min and {memory / 1e9:.1f} GB "
        f"on {settings.threads} cores"
    )


def _sweep(capture: Capture, settings: BuildSettings) -> tuple[float, float]:
    depth = settings.reconstruct.depth
    pixels = _pixels(capture, depth.side)
    work = len(capture.shots) * pixels * depth.neighbours
    each = depth.planes * _SWEEP_S + (_PLANES_S if settings.reconstruct.planes else 0.0)
    return work * each, 0.4e9 + pixels * depth.planes * _SWEEP_BYTES * settings.threads


def _training(capture: Capture, settings: BuildSettings) -> tuple[float, float]:
    options = settings.splat
    least, each, pixel = _STEP_S
    step = least + each * options.most / 2 + pixel * _pixels(capture, options.longest)
    return options.iterations * step, 0.4e9 + options.most * _GAUSSIAN_BYTES


def _pixels(capture: Capture, longest: int) -> float:
    """Return the pixels of a picture that is reduced so that no side is longer."""
    camera = capture.shots[0].camera
    scale = min(1.0, longest / max(camera.width, camera.height))
    return camera.width * camera.height * scale * scale
