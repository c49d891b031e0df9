"""The panel beside a trial: its timeline, its robot's own view, what happened when, and plots."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.view.plots import plot_of, window
from nw_eval.view.trace import Series, Trace, parting

STEP = 0.02
"""Seconds of a control step."""
_PLOT_EVERY = 0.25
"""Seconds between two plots that are sent while it plays."""
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2")
_MOST_OTHERS = 8
_WIDTH = 320  # pixels
_BLIND = "From its head (not seen by the policy)"


class Watched(Protocol):
    """What the panel steers."""

    time: float

    @property
    def plays(self) -> bool:
        """Whether it plays."""
        ...

    def choose(self, name: str, others: int = 0) -> None:
        """Show another trial."""
        ...

    def seek(self, moment: float) -> None:
        """Show a moment, s."""
        ...

    def play(self, wanted: bool) -> None:
        """Play or pause."""
        ...

    def show_mesh(self, wanted: bool) -> None:
        """Show the mesh of the place, or its splat alone."""
        ...


@dataclass(frozen=True, kw_only=True)
class PanelContent:
    """What is on the page.

    Attributes:
        names: of the trials that can be chosen.
        name: of the one that is shown.
        others: trials of its place that are its ghosts.
        most_others: of those there are.
        traces: the trial, then its ghosts.
        has_splat: of its place.
        note: what else is to be said.
    """

    names: Sequence[str]
    name: str
    others: int
    most_others: int
    traces: Sequence[Trace]
    has_splat: bool
    note: str = ""


class TrialPanel:
    """Draws the controls, and keeps them at the moment that is shown.

    Args:
        gui: viser's, empty.
        page: that they steer.
        shown: what is on it.

    Attributes:
        heading: what is said above the timeline.
    """

    def __init__(self, gui: Any, page: Watched, shown: PanelContent) -> None:
        self._page, self._traces = page, shown.traces
        self._plotted = 0.0
        self._choices(gui, shown)
        end = max(trace.end for trace in shown.traces)
        self._slider = gui.add_slider(
            "Time, s", min=0.0, max=max(STEP, round(end, 3)), step=STEP, initial_value=0.0
        )
        self._slider.on_update(self._on_slider)
        self._button = gui.add_button("Play")
        self._button.on_click(lambda _: page.play(not page.plays))
        steps = gui.add_button_group("Step", ("-10", "-1", "+1", "+10"))
        steps.on_click(lambda _: self._jump(page.time + int(steps.value) * STEP))
        self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
        if shown.has_splat:
            mesh = gui.add_checkbox("Mesh", initial_value=False)
            mesh.on_update(lambda _: page.show_mesh(mesh.value))
        label = "What the policy saw" if shown.traces[0].is_seen else _BLIND
        self._ego = gui.add_image(np.zeros((9, 16, 3), np.uint8), label=label)
        self._ego.visible = bool(len(shown.traces[0].frames[0]))
        with gui.add_folder("Events"):
            for moment, words in events_of(shown.traces):
                button = gui.add_button(f"{moment:.2f} s  {words}")
                button.on_click(lambda _, to=moment: self._jump(to))
        self._plots: list[tuple[Series, Any]] = []
        with gui.add_folder("Plots"):
            for series in shown.traces[0].series:
                self._plots.append((series, plot_of(gui, series)))

    @property
    def speed(self) -> float:
        """Seconds of the trial in a second."""
        return float(self._speed.value)

    def show(self, moment: float, *, plays: bool) -> None:
        """Put timeline, picture and plots to a moment, s."""
        if abs(self._slider.value - moment) > STEP / 2:
            self._slider.value = round(moment, 3)
        picture = self._traces[0].picture(moment)
        if picture is not None:
            self._ego.image = enlarged(picture)
        now = clock.monotonic()
        if not plays or now - self._plotted > _PLOT_EVERY:
            self._plotted = now
            for series, plot in self._plots:
                plot.data = window(series, moment)

    def show_plays(self, plays: bool) -> None:
        """Say what the button does."""
        self._button.label = "Pause" if plays else "Play"

    def _choices(self, gui: Any, shown: PanelContent) -> None:
        if len(shown.names) > 1:
            chosen = gui.add_dropdown("Trial", tuple(shown.names), initial_value=shown.name)
            chosen.on_update(lambda _: self._page.choose(chosen.value))
        if shown.most_others:
            others = gui.add_slider(
                "Others here",
                min=0,
                max=min(shown.most_others, _MOST_OTHERS),
                step=1,
                initial_value=shown.others,
                hint="Other trials of this place, as ghosts",
            )
            others.on_update(lambda _: self._page.choose(shown.name, others.value))
        self.heading = "\n\n".join([*_heading(shown.traces), *filter(None, [plain(shown.note)])])
        gui.add_markdown(self.heading)

    def _on_slider(self, event: Any) -> None:
        if event.client is not None:  # Moved by a person.
            self._jump(float(self._slider.value))

    def _jump(self, moment: float) -> None:
        self._page.play(wanted=False)
        self._page.seek(moment)


def events_of(traces: Sequence[Trace]) -> list[tuple[float, str]]:
    """Return what happened in the first of the trials, and where the others part from it."""
    found = list(traces[0].events)
    for trace in traces[1:]:
        apart = parting(traces[0], trace)
        if apart is not None:
            found.append((apart, f"parts from {_who(trace, traces[0])}"))
    return sorted(found, key=itemgetter(0))  # In the log's order where times are the same.


def enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) at least as wide as the panel, its pixels as squares."""
    factor = max(1, -(-_WIDTH // picture.shape[1]))
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def plain(text: str) -> str:
    """Return text that is no Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]()#+-.!|<>" else c for c in clean(text, at_most=200))


def _heading(traces: Sequence[Trace]) -> list[str]:
    lines = [plain(traces[0].name)]
    for number, trace in enumerate(traces):
        verdict: Mapping[str, str] = trace.logged.verdict
        end = verdict.get("outcome") or verdict.get("error_type") or "no outcome"
        mark = "" if number else "**"
        line = f"{mark}{plain(_who(trace, traces[0]))}{mark}: {plain(end)}"
        if number:
            apart = parting(traces[0], trace)
            line += "; never apart" if apart is None else f"; apart from {apart:.2f} s on"
        lines.append(line)
    return lines


def _who(trace: Trace, first: Trace) -> str:
    """Return the policy of a trial, or the trial itself where that is another."""
    if trace.name != first.name:
        return trace.name
    return clean(trace.logged.job.policy_name or trace.logged.job.policy, at_most=60)
