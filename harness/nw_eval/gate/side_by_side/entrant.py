"""One of several policies that are compared, and whether it may be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from nw_eval.errors import IncomparableError
from nw_eval.results.bank.manifest import BankKey, key_of
from nw_eval.results.bank.start import Panel, SavedBank, Start
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.results.row.column import Settings

StartName = tuple[str, Settings, int]
"""Scene, what was changed there, and the start's number: the same for every policy of a suite."""


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A policy with its results, of a run or of a bank."""

    source: str
    """The run or bank as it was named."""
    suite: str
    policy: str
    key: BankKey
    results: Mapping[StartName, Row | Start]
    """Of the trials that came to one."""


def entrant_of_run(source: str, run: RunInfo, rows: Iterable[Row]) -> Entrant:
    """Return what a run compares with."""
    return Entrant(
        source=source,
        suite=str(run.suite.get("name", "")),
        policy=run.policy.name,
        key=key_of(run),
        results=_named(row for row in rows if row.status == "ok"),
    )


def entrant_of_bank(source: str, bank: SavedBank, panel: Panel) -> Entrant:
    """Return what a bank compares with, on one class of machine."""
    return Entrant(
        source=source,
        suite=bank.manifest.suite,
        policy=bank.manifest.policy.name,
        key=bank.manifest.key,
        results=_named(panel.starts),
    )


def check_alike(entrants: Sequence[Entrant]) -> None:
    """Refuse policies that did not meet the same task.

    Raises:
        IncomparableError: naming every field in which one differs from the first.
    """
    first = entrants[0]
    for other in entrants[1:]:
        if faults := list(_faults(first, other)):
            raise IncomparableError(
                f"{other.source} does not compare with {first.source}: {'; '.join(faults)}",
                fix="run both with one suite, one version of nw-eval and the same scenes",
            )


def _named(results: Iterable[Row | Start]) -> dict[StartName, Row | Start]:
    return {(each.scene, each.perturbation, each.seed_index): each for each in results}


def _faults(first: Entrant, other: Entrant) -> Iterable[str]:
    ours, theirs = other.key, first.key
    for name in ("seed", "protocol"):
        if getattr(ours, name) != getattr(theirs, name):
            yield f"its {name} is {getattr(ours, name)}, there {getattr(theirs, name)}"
    alike = ours.seed == theirs.seed and ours.protocol == theirs.protocol
    if alike and ours.suite_digest != theirs.suite_digest:
        digests = f"{ours.suite_digest[:8]}, there {theirs.suite_digest[:8]}"
        yield f"its suite digest (robot, episode, perturb) is {digests}"
    if lacking := sorted({*theirs.scenes} - {*ours.scenes}):
        yield f"it has no scene {_first(lacking)}"
    if foreign := sorted({*ours.scenes} - {*theirs.scenes}):
        yield f"only it has scene {_first(foreign)}"
    both = sorted({*ours.scenes} & {*theirs.scenes})
    if changed := [name for name in both if ours.scenes[name] != theirs.scenes[name]]:
        digests = f"{ours.scenes[changed[0]][:8]}, there {theirs.scenes[changed[0]][:8]}"
        yield f"the digest of its scene {_first(changed)} is {digests}"
    for name in sorted({*ours.simulator, *theirs.simulator}):
        mine, others = (key.simulator.get(name, "none") for key in (ours, theirs))
        if mine != others:
            yield f"its {name} is {mine}, there {others}"


def _first(names: Sequence[str]) -> str:
    return names[0] + (f" (and {len(names) - 1} more)" if len(names) > 1 else "")
