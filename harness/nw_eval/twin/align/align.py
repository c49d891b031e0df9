"""Aligning a capture: up by consensus, scale by a tag or what else is known, the floor at z = 0."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError, nearest
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.align.alignment import (
    MOST_DEGREES,
    MOST_DIFFERENCE,
    Alignment,
    AlignOptions,
    GravityCue,
    ScaleCue,
)
from nw_eval.twin.align.gravity import KnownUp, Mesh, find_gravity
from nw_eval.twin.align.positions import PositionFit, fit_positions
from nw_eval.twin.align.scale import find_scale
from nw_eval.twin.capture import Capture
from nw_eval.twin.moved import moved_mesh
from nw_eval.words import UpAxis

Values = NDArray[np.float64]

_SOURCE = math.radians(0.5)
"""How well a phone knows gravity."""
_MOST_TURNED = math.radians(3.0)
"""Positions that lie along a line know up worse than this, and do not say."""


def align(
    capture: Capture,
    capture_folder: Path | None,
    mesh: Mesh | None = None,
    options: AlignOptions | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Alignment:
    """Return the similarity from a capture's frame to metres: z up, the floor at z = 0.

    The same capture in any other rotation, scale and place gives the same metric scene.

    Args:
        capture: as calibrated.
        capture_folder: with its pictures, in which upright edges and tags are looked for; None =
            they are not looked at.
        mesh: vertices (V, 3) in the capture's frame and faces (F, 3); it makes the floor exact.
        options: what no photograph tells; None = nothing is known, which gives no scale: the frame
            is then in a unit of its own, see `Alignment.is_to_scale`.
        say: hears how far it has come.

    Raises:
        UsageError: an option makes no sense.
        SceneError: the capture has too few points, or a picture cannot be read.
        PrerequisiteError: what finds tags is not installed.
    """
    options = AlignOptions() if options is None else options
    rng = np.random.default_rng(options.seed)
    positions = _positions(capture, options, rng)
    gravity = find_gravity(capture, mesh, _known(options, positions), rng, say, capture_folder)
    for cue in gravity.cues:
        say(
            f"up by {cue.name}: {cue.degrees:.2f} degrees from the chosen one, uncertain by "
            f"{cue.uncertain:.1f}; {cue.reason}"
        )
    say(f"up is known to {gravity.uncertain:.1f} degrees")
    scale = find_scale(
        capture,
        capture_folder,
        options,
        up=gravity.up,
        heights=gravity.heights,
        has_floor=gravity.has_floor,
        surface=None
        if mesh is None or not options.lengths
        else RayScene(moved_mesh(np.eye(4), *mesh)),
        positions=positions,
        say=say,
    )
    for cue in scale.cues:
        say(f"scale by {cue.name}: {cue.scale:.5g} m, {cue.difference:+.1%}; {cue.reason}")
    warnings = (
        *gravity.warnings,
        *scale.warnings,
        *_disagreements(gravity.cues, scale.cues),
    )
    for warning in warnings:
        say(f"warning: {warning}")
    return Alignment(
        T_metric_capture=placed(
            up=gravity.up,
            scale=scale.scale,
            floor=gravity.floor,
            centres=capture.centres,
            forward=capture.shots[0].camera.T_world_camera[:3, 2],
        ),
        scale=scale.scale,
        gravity=gravity.cues,
        scales=scale.cues,
        floor_share=gravity.floor_share,
        warnings=warnings,
        up_uncertain=gravity.uncertain,
    )


def _positions(
    capture: Capture, options: AlignOptions, rng: np.random.Generator
) -> PositionFit | None:
    if not options.positions:
        return None
    places = {shot.name: place for place, shot in enumerate(capture.shots)}
    known = [name for name in options.positions if name in places]
    if not known:
        name = next(iter(options.positions))
        raise UsageError(
            f"none of {len(options.positions)} positions is of a shot of the capture: {name!r}",
            fix=nearest(name, places),
        )
    rows = [places[name] for name in known]
    metres = np.array([options.positions[name] for name in known], dtype=np.float64)
    return fit_positions(capture.centres[rows], metres, rng)


def _known(options: AlignOptions, positions: PositionFit | None) -> list[KnownUp]:
    known: list[KnownUp] = []
    if options.up is not None:
        reason = f"{options.up} is up, as their source says"
        known.append(KnownUp(name="poses", up=_axis(options.up), sigma=_SOURCE, reason=reason))
    if positions is not None and options.positions_up is not None:
        up = positions.rotation.T @ _axis(options.positions_up)
        if positions.turned <= _MOST_TURNED:
            reason = f"known to {math.degrees(positions.turned):.1f} degrees"
            sigma = math.hypot(_SOURCE, positions.turned)
            known.append(KnownUp(name="positions", up=up, sigma=sigma, reason=reason))
    return known


def _axis(name: UpAxis) -> Values:
    axis = np.zeros(3)
    axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return axis


def _disagreements(gravity: tuple[GravityCue, ...], scales: tuple[ScaleCue, ...]) -> list[str]:
    return [
        f"up by {cue.name} is {cue.degrees:.1f} degrees off ({cue.reason})"
        for cue in gravity
        if cue.degrees > max(MOST_DEGREES, 2.0 * cue.uncertain)
    ] + [
        f"the scale by {cue.name} differs by {cue.difference:+.1%} from that by {scales[0].name}"
        for cue in scales
        if abs(cue.difference) > MOST_DIFFERENCE
    ]


def placed(*, up: Values, scale: float, floor: float, centres: Values, forward: Values) -> Values:
    """Return T_metric_capture (4, 4).

    The origin lies on the floor below the first camera, x leads to the camera that is farthest from
    it in the plane. Where no camera moved, x is the way that the first one looks.

    Args:
        up: (3,) unit vector in the capture's frame.
        scale: metres in a unit of the capture.
        floor: its height along `up`, in the capture's unit.
        centres: (V, 3) of the cameras, one at least.
        forward: (3,) where the first camera looks.
    """
    ways = centres - centres[0]
    ways = ways - np.einsum("ni,i->n", ways, up)[:, None] * up
    lengths = np.linalg.norm(ways, axis=1)
    heights = np.einsum("ni,i->n", centres, up) - floor
    x = ways[int(np.argmax(lengths))]
    if lengths.max() < 0.05 * float(np.abs(heights).max()):
        x = forward - (forward @ up) * up
    if np.linalg.norm(x) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        x = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])  # It looks straight down.
    x = x - (x @ up) * up
    x = x / np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = centres[0] - float(heights[0]) * up
    T = np.eye(4)
    T[:3, :3] = scale * rotation
    T[:3, 3] = -scale * rotation @ origin
    return T
