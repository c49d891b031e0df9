"""Baselines: what a baseline scored from every start of a seed set, kept in git beside the suite.

A baseline is one file, `reports/baselines/<suite>/<name>.parquet` (`baseline_file`): the results of
S scenes by M starts without wall times, once for each class of machine that they were run on, and a
manifest: who made it, when, why, and what must match for it to hold.

`baseline_change` compares two baselines: what they hold for, and what happened from their starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from statistics import fmean
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from nw_base.files.shipped import available
from nw_base.plugins import is_measure
from nw_gate.results.column import Settings
from nw_gate.results.provenance import BaselineInfo, RunInfo
from nw_gate.results.row import Row

_SIMULATOR = ("mujoco", "rays", "renderer")
"""Parts of `RunInfo.engine` that are the simulated world: in another version it is another one."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class BaselineKey(_Part):
    """What a baseline holds for, and nothing else: each field is named where it does not match."""

    suite_digest: str
    """Of robot, protocol, seed, episode and perturbations: what names the starts."""
    seed: int
    protocol: str
    scenes: dict[str, str]
    """Digests of the scenes by name."""
    simulator: dict[str, str]
    """Versions of what makes the simulated world: mujoco, rays, renderer."""
    measured: dict[str, str] = {}
    """Package, version and code of each score that a package brings along: `scores.NAME`."""


class BaselinePolicy(_Part):
    """The baseline's policy."""

    name: str
    card_digest: str
    checkpoint_digest: str
    card: str = ""
    """Where its card was, for a machine that the baseline has not seen: a shipped bundle's name,
    or a path from the folder of the run."""

    @property
    def typed(self) -> str:
        """What a command's --policy is to say: PATH where it lay outside the project."""
        if self.card or self.name in available("policies"):
            return self.card or self.name
        return "PATH"


class PanelInfo(_Part):
    """One class of machine on which all starts were run."""

    machine: dict[str, str]
    """What decides the bits of arithmetic besides the simulator: kind of processor, versions of
    numerical libraries, digest of nw-eval's code."""
    saved: str
    """When, UTC in ISO 8601."""
    by: str
    """Who."""
    rows_digest: str
    """Of the rows that these results are made from."""


class SavedLimit(_Part):
    """The policy's limit on one ladder."""

    limit: dict[str, Any]
    """`Limit.as_dict`."""
    suite_digest: str
    """Of robot, protocol, seed, episode and perturbations of its trials."""
    scenes: dict[str, str]
    """Digests of its rungs' scenes by name."""
    machine: dict[str, str]
    """Class of machine that its trials ran on."""


class Manifest(_Part):
    """All that a baseline says of itself."""

    bank: int = Field(1, description="Version of this format.")
    name: str
    suite: str
    """The suite's name."""
    note: str = ""
    """Why it was made."""
    starts: int = Field(ge=1)
    """M: starts in each scene and perturbation."""
    key: BaselineKey
    policy: BaselinePolicy
    panels: tuple[PanelInfo, ...] = Field(min_length=1)
    scores: tuple[str, ...] = ()
    """Names of the scores that its trials were measured by."""
    limits: dict[str, SavedLimit] = {}
    """Of the ladders that the suite's gate names, by name."""
    held_out: bool = False
    """Whether its starts are of a seed set of its own, which took no part in choosing its policy. A
    run on the suite's seed set met other starts, and is compared as one that met fresh ones."""


def key_of(run: RunInfo) -> BaselineKey:
    """Return what a baseline must have to be compared with a run."""
    return BaselineKey(
        suite_digest=run.suite_digest,
        seed=int(run.suite.get("seed", 0)),
        protocol=str(run.suite.get("protocol", "")),
        scenes={name: scene.digest for name, scene in run.scenes.items()},
        simulator={name: run.engine[name] for name in _SIMULATOR if name in run.engine},
        measured={key: whose for key, whose in run.plugins.items() if is_measure(key)},
    )


def machine_of(run: RunInfo) -> dict[str, str]:
    """Return the class of machine that a run was made on."""
    return machine_in(run.engine)


def machine_in(engine: Mapping[str, str]) -> dict[str, str]:
    """Return the class of machine that `RunInfo.engine` names."""
    return {
        name: value
        for name, value in engine.items()
        if name not in _SIMULATOR and not is_measure(name)
    }


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
    task_kind: str = "course"
    scores: Settings = ()

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
class BaselineResults:
    """A baseline as its file has it; `panels` are in the manifest's order."""

    manifest: Manifest
    panels: tuple[Panel, ...]

    def panel_of(self, machine: Mapping[str, str]) -> Panel | None:
        """Return the results of machines of this class; None if there are none."""
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


@dataclass(frozen=True, kw_only=True)
class ControlArm:
    """Trials of the baseline's own policy that ran beside the candidate, from the same starts."""

    run: RunInfo
    rows: tuple[Row, ...]


@dataclass(frozen=True, kw_only=True)
class LoadedBaseline:
    """The baseline that a run is compared with."""

    info: BaselineInfo
    results: BaselineResults
    content: bytes
    """Of its file, of which the run's folder gets a copy."""
    control: ControlArm | None = None
    """None where the baseline says what its policy does on the machine of the run."""

    def rivals(self, rows: Iterable[Row], run: RunInfo) -> dict[str, Row | Start]:
        """Return what the baseline's policy did from the starts of trials, by their names.

        Trials that ran beside them say when; a baseline says only how far.

        Args:
            rows: of the candidate, from starts of the baseline's panel.
            run: its run.json.
        """
        panel = self.results.panel_of(machine_of(run)) or self.results.panels[0]
        known: dict[tuple[Stratum, int], Row | Start] = {
            (start.stratum, start.seed_index): start for start in panel.starts
        }
        for row in () if self.control is None else self.control.rows:
            known[(row.scene, row.perturbation), row.seed_index] = row
        by_trial = {
            row.trial_id: known.get(((row.scene, row.perturbation), row.seed_index)) for row in rows
        }
        return {trial: rival for trial, rival in by_trial.items() if rival is not None}

    def of_run(self, info: BaselineInfo) -> LoadedBaseline:
        """Return the baseline as a run knows it, that was begun with it somewhere else."""
        return replace(self, info=info.model_copy(update={"checked": None, "moved": ()}))


Part = Literal["suite", "scene", "simulator", "score", "policy", "machine"]
"""What a field is of. All but the machine must match for a baseline to hold."""

_NONE = "none"


@dataclass(frozen=True, kw_only=True)
class FieldChange:
    """One field that is not what it was."""

    part: Part
    name: str
    """Such as `seed`, `mujoco`, or a scene's name."""
    then: str
    now: str


@dataclass(frozen=True, kw_only=True)
class SceneChange:
    """One scene, with what was changed in it, in two baselines; in the order of the baselines."""

    scene: str
    perturbation: Settings = ()
    then: float | None
    """Mean success over the starts; None where the baseline has no such scene."""
    now: float | None
    starts: int
    """Starts that both have."""
    moved: int
    """Of these, such as went another way: not one bit differs in the others."""
    flipped: tuple[int, ...]
    """Indexes of these that ended in another way, or scored otherwise."""


@dataclass(frozen=True, kw_only=True)
class BaselineChange:
    """What differs between an earlier and a later baseline of a suite."""

    then: BaselineResults
    now: BaselineResults
    fields: tuple[FieldChange, ...]
    """What must match and does not, the number of starts included."""
    machine: tuple[FieldChange, ...]
    """In what the class of machine differs between the two sets of results that are compared:
    none, where there is one that both baselines have."""
    scenes: tuple[SceneChange, ...]

    @property
    def parts(self) -> frozenset[Part]:
        """What has changed of what must match."""
        return frozenset(field.part for field in self.fields)


def baseline_change(earlier: BaselineResults, later: BaselineResults) -> BaselineChange:
    """Compare two baselines on a class of machine that both have, or on their first ones."""
    before, after = _panels(earlier, later)
    strata = sorted({*before.by_stratum, *after.by_stratum})
    return BaselineChange(
        then=earlier,
        now=later,
        fields=(
            *key_changes(earlier.manifest.key, later.manifest.key),
            *_differences("suite", _starts(earlier), _starts(later)),
            *policy_changes(earlier.manifest.policy, later.manifest.policy),
        ),
        machine=machine_changes(before.machine, after.machine),
        scenes=tuple(_scene_change(stratum[0], stratum[1], before, after) for stratum in strata),
    )


def key_changes(before: BaselineKey, after: BaselineKey) -> tuple[FieldChange, ...]:
    """Return what differs between two keys: suite, scenes, simulator, scores, in this order."""
    suite = [
        ("seed", str(before.seed), str(after.seed)),
        ("protocol", before.protocol, after.protocol),
        ("digest", before.suite_digest[:16], after.suite_digest[:16]),
    ]
    changed = [
        FieldChange(part="suite", name=name, then=old, now=new)
        for name, old, new in suite
        if old != new
    ]
    short = [{name: digest[:16] for name, digest in key.scenes.items()} for key in (before, after)]
    return (
        *changed,
        *_differences("scene", *short),
        *_differences("simulator", before.simulator, after.simulator),
        *_differences("score", before.measured, after.measured),
    )


def policy_changes(before: BaselinePolicy, after: BaselinePolicy) -> tuple[FieldChange, ...]:
    """Return what differs between two policies: the digests of checkpoint and card."""
    pairs = {
        "checkpoint": (before.checkpoint_digest[:16], after.checkpoint_digest[:16]),
        "card": (before.card_digest[:16], after.card_digest[:16]),
    }
    return tuple(
        FieldChange(part="policy", name=name, then=old, now=new)
        for name, (old, new) in pairs.items()
        if old != new
    )


def machine_changes(before: Mapping[str, str], after: Mapping[str, str]) -> tuple[FieldChange, ...]:
    """Return what differs between two classes of machine."""
    return tuple(_differences("machine", before, after))


def mean_of(starts: Sequence[Start]) -> float:
    """Return the mean success over some starts; a policy that failed by itself scores 0."""
    return fmean(score(start) or 0.0 for start in starts)


def baseline_mean(baseline: BaselineResults) -> float:
    """Return B: the mean over scenes and cells of the means over starts, on the first machine."""
    return fmean(mean_of(starts) for starts in baseline.panels[0].by_stratum.values())


def _panels(before: BaselineResults, after: BaselineResults) -> tuple[Panel, Panel]:
    for panel in after.panels:
        if (earlier := before.panel_of(panel.machine)) is not None:
            return earlier, panel
    return before.panels[0], after.panels[0]


def _scene_change(scene: str, cell: Settings, before: Panel, after: Panel) -> SceneChange:
    old = before.by_stratum.get((scene, cell), ())
    new = after.by_stratum.get((scene, cell), ())
    pairs = list(zip(old, new, strict=False))
    return SceneChange(
        scene=scene,
        perturbation=cell,
        then=mean_of(old) if old else None,
        now=mean_of(new) if new else None,
        starts=len(pairs),
        moved=sum(a.trajectory != b.trajectory for a, b in pairs),
        flipped=tuple(
            a.seed_index for a, b in pairs if (a.outcome, a.success) != (b.outcome, b.success)
        ),
    )


def _starts(baseline: BaselineResults) -> Mapping[str, str]:
    return {"starts": str(baseline.manifest.starts)}


def _differences(
    part: Part, before: Mapping[str, str], after: Mapping[str, str]
) -> Iterable[FieldChange]:
    for name in sorted({*before, *after}):
        old, new = before.get(name, _NONE), after.get(name, _NONE)
        if old != new:
            yield FieldChange(part=part, name=name, then=old, now=new)
