"""What differs between two banks: what they hold for, and what happened from their starts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal

from nw_eval.results.bank import BankKey, BankPolicy, BaselineResults, Panel, Start, score
from nw_eval.results.column import Settings

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
    none, where there is one that both banks have."""
    scenes: tuple[SceneChange, ...]

    @property
    def parts(self) -> frozenset[Part]:
        """What has changed of what must match."""
        return frozenset(field.part for field in self.fields)


def bank_change(then: BaselineResults, now: BaselineResults) -> BaselineChange:
    """Compare two baselines on a class of machine that both have, or on their first ones."""
    before, after = _panels(then, now)
    strata = sorted({*before.by_stratum, *after.by_stratum})
    return BaselineChange(
        then=then,
        now=now,
        fields=(
            *key_changes(then.manifest.key, now.manifest.key),
            *_differences("suite", _starts(then), _starts(now)),
            *policy_changes(then.manifest.policy, now.manifest.policy),
        ),
        machine=machine_changes(before.machine, after.machine),
        scenes=tuple(_scene_change(stratum[0], stratum[1], before, after) for stratum in strata),
    )


def key_changes(then: BankKey, now: BankKey) -> tuple[FieldChange, ...]:
    """Return what differs between two keys: suite, scenes, simulator, scores, in this order."""
    suite = [
        ("seed", str(then.seed), str(now.seed)),
        ("protocol", then.protocol, now.protocol),
        ("digest", then.suite_digest[:16], now.suite_digest[:16]),
    ]
    changed = [
        FieldChange(part="suite", name=name, then=old, now=new)
        for name, old, new in suite
        if old != new
    ]
    short = [{name: digest[:16] for name, digest in key.scenes.items()} for key in (then, now)]
    return (
        *changed,
        *_differences("scene", *short),
        *_differences("simulator", then.simulator, now.simulator),
        *_differences("score", then.measured, now.measured),
    )


def policy_changes(then: BankPolicy, now: BankPolicy) -> tuple[FieldChange, ...]:
    """Return what differs between two policies: the digests of checkpoint and card."""
    pairs = {
        "checkpoint": (then.checkpoint_digest[:16], now.checkpoint_digest[:16]),
        "card": (then.card_digest[:16], now.card_digest[:16]),
    }
    return tuple(
        FieldChange(part="policy", name=name, then=old, now=new)
        for name, (old, new) in pairs.items()
        if old != new
    )


def machine_changes(then: Mapping[str, str], now: Mapping[str, str]) -> tuple[FieldChange, ...]:
    """Return what differs between two classes of machine."""
    return tuple(_differences("machine", then, now))


def mean_of(starts: Sequence[Start]) -> float:
    """Return the mean success over some starts; a policy that failed by itself scores 0."""
    return fmean(score(start) or 0.0 for start in starts)


def bank_mean(bank: BaselineResults) -> float:
    """Return B: the mean over scenes and cells of the means over starts, on the first machine."""
    return fmean(mean_of(starts) for starts in bank.panels[0].by_stratum.values())


def _panels(then: BaselineResults, now: BaselineResults) -> tuple[Panel, Panel]:
    for panel in now.panels:
        if (earlier := then.panel_of(panel.machine)) is not None:
            return earlier, panel
    return then.panels[0], now.panels[0]


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


def _starts(bank: BaselineResults) -> Mapping[str, str]:
    return {"starts": str(bank.manifest.starts)}


def _differences(
    part: Part, then: Mapping[str, str], now: Mapping[str, str]
) -> Iterable[FieldChange]:
    for name in sorted({*then, *now}):
        old, new = then.get(name, _NONE), now.get(name, _NONE)
        if old != new:
            yield FieldChange(part=part, name=name, then=old, now=new)
