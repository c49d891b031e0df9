"""The page: clicks, keys and buttons act on a labelling; whatever goes wrong is shown on it.

The height profile is an SVG drawing, heights three times as large as distances where it fits.
"""

from __future__ import annotations

import html
import threading
from collections.abc import Callable
from typing import Any, Self

import numpy as np

from nw_base.errors import NwEvalError
from nw_eval.viewing.browser import HOST, splat_points, stop, viser_server
from nw_scenes.folder import SCENE_FILE
from nw_splat.gaussians import Gaussians
from nw_twin.label.controls import CLICKS, Controls
from nw_twin.label.drawing import Drawing, first_level
from nw_twin.label.ground import HeightProfile
from nw_twin.label.labelling import NEEDS_SCALE, Labelling
from nw_twin.label.state import Point, as_point

PUBLISHED = "published"
"""The folder, in the scene's, in which the published XML pair appears."""

_WIDTH, _HEIGHT = 420, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 12, 16, 26
_POINTS = 600  # of the line: more than pixels


class LabelPage:
    """Serves a labelling to browsers until it is closed; a context manager.

    It listens at this machine's own address only, and other web pages are turned away; whoever
    else is logged in on this machine can reach it.

    Args:
        labelling: which no other code may change meanwhile.
        splat: the looks of the scene, in the splat's frame; None = the mesh is shown.
        port: to listen at; 0 = one that is free.
        on_save: takes a line for people whenever something was saved.

    Attributes:
        controls: the panel.
        server: viser's.

    Raises:
        PrerequisiteError: viser is not installed, or cannot be guarded.
        UsageError: it cannot listen there.
    """

    def __init__(
        self,
        labelling: Labelling,
        splat: Gaussians | None = None,
        *,
        port: int = 0,
        on_save: Callable[[str], object] = lambda _: None,
    ) -> None:
        self._labelling = labelling
        self._on_save = on_save
        self._lock = threading.RLock()  # Callbacks come from a pool of threads.
        points = None
        if splat is not None:
            points = splat_points(splat, labelling.place.T_world_splat)
        self.server: Any = viser_server(port, "nw-eval label")
        self._is_open = True
        try:
            self._drawing = Drawing(self.server, labelling, points)
            eye = as_point(self.server.initial_camera.position)
            level = first_level(labelling.ground, points, eye, labelling.start.position)
            self.controls = Controls(
                self.server.gui,
                labelling,
                self.run,
                self.save,
                level=level,
                has_splat=points is not None,
                look=self._look,
            )
            self.server.scene.on_click()(self._on_click)
            self._refresh()
        except BaseException:
            stop(self.server)
            raise

    @property
    def url(self) -> str:
        """Where browsers find it."""
        return f"http://{HOST}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving; a second time does nothing."""
        with self._lock:
            was_open, self._is_open = self._is_open, False
        if was_open:
            stop(self.server)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self, action: Callable[[], object]) -> None:
        """Run an action, and show what it changed; an error is shown, never raised."""
        with self._lock:
            if not self._is_open:
                return
            try:
                words = action()
                self._refresh()
                self.controls.tell(words if isinstance(words, str) else "")
            except NwEvalError as error:
                self._show_error(str(error))
            except Exception as error:  # noqa: BLE001 - otherwise it would only be in a log.
                self._show_error(f"{type(error).__name__}: {error} (a fault of nw-eval)")

    def click(self, origin: Point, direction: Point) -> None:
        """Place the chosen object where a ray (world, m) meets the scene."""
        labelling, controls = self._labelling, self.controls
        seen_from = self._drawing.cutaway.ray(origin, direction)
        point = labelling.snapped(seen_from, direction) if seen_from is not None else None
        if point is None:
            return
        what = controls.click
        if what == CLICKS[0]:
            labelling.add_waypoint(point)
            controls.chosen = len(labelling.state.waypoints) - 1
        elif what == CLICKS[1]:
            labelling.move_waypoint(controls.chosen, point)
        elif what == CLICKS[2]:
            labelling.set_start(point)
        elif what == CLICKS[3]:
            labelling.mark(point)
        else:
            labelling.click_floor(point)

    def save(self, publishes: bool) -> str:
        """Save, the published XML pair too where it is wanted; return what to tell people."""
        labelling = self._labelling
        folder = labelling.save()
        self._on_save(f"{folder / SCENE_FILE}: {labelling.words}")
        text = f"✓ Saved `{folder / SCENE_FILE}`."
        if publishes:
            pair = labelling.publish(folder / PUBLISHED)
            self._on_save(f"{pair}: the same, as Neverwhere publishes scenes")
            text += f" The XML pair is beside it in `{pair.relative_to(folder)}`."
        return text

    def _on_click(self, event: Any) -> None:
        self.run(lambda: self.click(event.ray_origin, event.ray_direction))

    def _look(self) -> None:
        for client in self.server.get_clients().values():
            self._drawing.aim(client.camera)

    def _refresh(self) -> None:
        controls, labelling = self.controls, self._labelling
        controls.refresh()
        place, drawing = controls.place, self._drawing
        drawing.shows_splat, drawing.shows_mesh = place.shows_splat, place.shows_mesh
        drawing.cutaway = place.cutaway
        with self.server.atomic():
            drawing.refresh(controls.chosen if labelling.state.waypoints else None, place.preview)
        controls.chart.content = profile_svg(labelling.profile())
        marks = {"warning": "⚠️", "note": "✓"}
        lines = [f"{marks[hint.severity]} {hint.text}" for hint in labelling.hints()]
        if not labelling.state.to_scale:
            lines = [f"{marks['warning']} **Not to scale, and runs nowhere yet**: {NEEDS_SCALE}."]
        controls.hints.content = "\n\n".join(lines)

    def _show_error(self, text: str) -> None:
        self.controls.tell(f"**❌ {html.escape(text)}**")
        for client in self.server.get_clients().values():
            client.add_notification("That did not work", text, color="red", auto_close_seconds=10)


def profile_svg(profile: HeightProfile) -> str:
    """Return a drawing of the ground along a course, with its start and waypoints.

    Ground that is not there is left out of the line.
    """
    finite = profile.height[np.isfinite(profile.height)]
    if not len(finite):
        return _svg(f'<text x="{_LEFT}" y="{_HEIGHT // 2}">no ground along the course yet</text>')
    length = max(float(profile.distance[-1]), 0.5)
    levels = np.concatenate([finite, profile.levels])
    middle = float(levels.max() + levels.min()) / 2
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    span = max(float(np.ptp(levels)) * 1.15, length / wide * high / 3, 0.1)

    def x_of(distance: float) -> float:
        return _LEFT + distance / length * wide

    def y_of(height: float) -> float:
        return _TOP + (0.5 - (height - middle) / span) * high

    parts: list[str] = []
    for height in _round_values(middle - span / 2, middle + span / 2):
        y = y_of(height)
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 4}" y="{y + 3:.1f}" text-anchor="end">{height:.2f}</text>'
        )
    parts += [
        f'<text x="{x_of(at):.1f}" y="{_HEIGHT - 12}" text-anchor="middle">{at:g}</text>'
        for at in _round_values(0.0, length)
    ]
    parts.append(
        f'<text x="{_WIDTH - _RIGHT}" y="{_HEIGHT - 1}" text-anchor="end">m from the start</text>'
    )
    parts += [
        f'<polyline points="{line}" fill="none" stroke="#345" stroke-width="1.5"/>'
        for line in _lines(profile, x_of, y_of)
    ]
    for i, (at, level) in enumerate(zip(profile.stops, profile.levels, strict=True)):
        x, y = x_of(float(at)), y_of(float(level))
        colour = "#e8590c" if i else "#2b8a3e"
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'
            f'<text x="{x:.1f}" y="{y - 7:.1f}" text-anchor="middle">{i or "start"}</text>'
        )
    return _svg("".join(parts))


def _svg(content: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" role="img" '
        'aria-label="height of the ground along the course" font-size="10" '
        f'font-family="sans-serif" fill="#444" style="background:#fff">{content}</svg>'
    )


def _lines(
    profile: HeightProfile, x_of: Callable[[float], float], y_of: Callable[[float], float]
) -> list[str]:
    """Return the points of each stretch that has ground."""
    step = max(len(profile.distance) // _POINTS, 1)
    lines: list[list[str]] = [[]]
    for distance, height in zip(
        profile.distance[::step].tolist(), profile.height[::step].tolist(), strict=True
    ):
        if np.isfinite(height):
            lines[-1].append(f"{x_of(distance):.1f},{y_of(height):.1f}")
        elif lines[-1]:
            lines.append([])
    return [" ".join(line) for line in lines if line]


def _round_values(low: float, high: float) -> list[float]:
    """Return three to eight round numbers between two."""
    rough = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(min((1, 2, 5, 10), key=lambda part: abs(part * power - rough)) * power)
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [round(i * step, 6) for i in range(first, last + 1)]
