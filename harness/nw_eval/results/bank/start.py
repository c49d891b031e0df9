"""What a bank holds of each trial, and the bank as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

from nw_eval.results.bank.manifest import Manifest
from nw_eval.results.row.column import Settings
from nw_eval.results.row.row import Row

Stratum = tuple[str, Settings]
"""A scene, and what was changed in it: starts are drawn, and scores averaged, within one."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """The baseline's result from one start; as the columns of `Row` with the same names."""

    scene: str
    task: str
    perturbation: Settings = ()
    seed_index: int
    success: float
    completed: bool
    waypoints_reached: int
    waypoints_total: int
    outcome: str
    end_reason: str
    trajectory: str
    """`trajectory` of its row."""

    @property
    def stratum(self) -> Stratum:
        """Its scene and what was changed there."""
        return (self.scene, self.perturbation)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """All starts on one class of machine, in the order of scene, perturbation and index."""

    machine: Mapping[str, str]
    """`PanelInfo.machine`."""
    starts: tuple[Start, ...]

    @cached_property
    def by_stratum(self) -> Mapping[Stratum, tuple[Start, ...]]:
        """Starts 0 .. M - 1 of every scene and perturbation."""
        groups: dict[Stratum, list[Start]] = {}
        for start in self.starts:
            groups.setdefault(start.stratum, []).append(start)
        return {stratum: tuple(starts) for stratum, starts in groups.items()}


@dataclass(frozen=True, kw_only=True)
class SavedBank:
    """A bank as its file has it; the panels are those of the manifest, in its order."""

    manifest: Manifest
    panels: tuple[Panel, ...]

    def panel_of(self, machine: Mapping[str, str]) -> Panel | None:
        """Return the panel that was run on machines of this class; None if none was."""
        return next((panel for panel in self.panels if panel.machine == machine), None)


def score(trial: Row | Start) -> float | None:
    """Return what a trial counts in a comparison: its success, None where it has no result.

    A policy that failed by itself (`policy_failed`) scores 0 wherever it got to: it would have had
    to be stopped on the robot, too. The absolute bar counts its waypoints; a comparison counts the
    same for baseline and candidate.
    """
    return 0.0 if trial.outcome == "policy_failed" else trial.success


def trajectory(row: Row) -> str:
    """Return 16 hex digits that are equal where two trials went the same way, bit for bit.

    They are of the digests of states and actions; 64 bits tell an accident, not an adversary.
    """
    return sha256(f"{row.state_digest}/{row.action_digest}".encode()).hexdigest()[:16]
