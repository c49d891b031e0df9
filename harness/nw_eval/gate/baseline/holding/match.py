"""What of a bank does not match a run: each field by name, with both values and what renews it."""

from __future__ import annotations

from collections.abc import Iterable
from shlex import quote

from nw_eval.errors import IncomparableError
from nw_eval.results.bank import SavedBank
from nw_eval.results.bank.manifest import key_of
from nw_eval.results.provenance import RunInfo
from nw_eval.suite.model import Suite, new_suite

_NAMED = 3  # scenes that a sentence names before it says "and more"


def check_match(run: RunInfo, bank: SavedBank) -> None:
    """Refuse a bank that does not hold for a run.

    A run on a fresh panel differs in its seed, and may; one that was asked for some scenes only may
    lack the others.

    Raises:
        IncomparableError: naming every field that differs.
    """
    faults = [*_suite_faults(run, bank), *_scene_faults(run, bank), *_simulator_faults(run, bank)]
    if faults:
        raise IncomparableError(
            f"baseline {bank.manifest.name} is not compatible with run {run.id}: "
            f"{'; '.join(faults)}",
            fix=f"renew the baseline with `{renewing(run, bank)}`",
        )


def renewing(run: RunInfo, bank: SavedBank, *options: str) -> str:
    """Return the command that makes a bank anew for the suite of a run.

    Args:
        run: the run.
        bank: the bank.
        options: what the command is to say besides, in place of --renew.
    """
    suite, policy = bank.manifest.suite, bank.manifest.policy.typed
    if run.request is not None:
        suite = str(run.request.suite or suite)
        policy = run.request.baseline_policy or policy
    return saving(bank, suite, policy, *options)


def saving(bank: SavedBank, suite: str, policy: str, *options: str) -> str:
    """Return the command that makes a bank anew for a suite, from a policy as it can be typed."""
    own = bank.manifest.name
    name = [] if own == bank.manifest.policy.name else ["--name", own]
    words = ["nw-eval", "baseline", "save", suite, "--policy", policy, *(options or ["--renew"])]
    return " ".join(quote(word) for word in [*words, *name])


def _suite_faults(run: RunInfo, bank: SavedBank) -> Iterable[str]:
    ours, theirs = key_of(run), bank.manifest.key
    if ours.seed != theirs.seed and run.panel == "pinned":
        yield f"its seed is {ours.seed}, the baseline's {theirs.seed}"
    if ours.protocol != theirs.protocol:
        yield f"its protocol is {ours.protocol}, the baseline's {theirs.protocol}"
    if ours.seed == theirs.seed and run.panel == "fresh":
        yield f"its seed {ours.seed} is the baseline's, so its starts are not fresh"
    if ours.suite_digest == theirs.suite_digest:
        return
    # Whatever differs besides seed and protocol is in the digest alone.
    alike = new_suite({**run.suite, "seed": theirs.seed, "protocol": theirs.protocol})
    if alike.digest != theirs.suite_digest:
        digests = f"{ours.suite_digest[:8]}, the baseline's {theirs.suite_digest[:8]}"
        yield f"its suite digest is {digests}: {_what_else(alike, bank)}"


def _what_else(suite: Suite, bank: SavedBank) -> str:
    """Return which settings differ, as far as a bank knows its own."""
    ours = sorted(suite.perturb.cells)
    theirs = sorted({cell for _, cell in bank.panels[0].by_stratum})
    if ours == theirs:
        return "robot or episode differ"
    return f"perturb is {_cells(ours)}, the baseline's {_cells(theirs)}"


def _cells(cells: list[tuple[tuple[str, float], ...]]) -> str:
    return ", ".join(
        " ".join(f"{axis} {value:g}" for axis, value in cell) or "nothing" for cell in cells
    )


def _scene_faults(run: RunInfo, bank: SavedBank) -> Iterable[str]:
    ours, theirs = key_of(run).scenes, bank.manifest.key.scenes
    if unknown := sorted(set(ours) - set(theirs)):
        yield f"{_scenes(unknown)} not in the baseline"
    restricted = run.request is not None and run.request.scenes is not None
    if (absent := sorted(set(theirs) - set(ours))) and not restricted:
        yield f"{_scenes(absent)} in the baseline and not in the run"
    changed = sorted(name for name in set(ours) & set(theirs) if ours[name] != theirs[name])
    if changed:
        first = changed[0]
        digests = f"{ours[first][:8]} now, {theirs[first][:8]} in the baseline"
        more = f", and {len(changed) - 1} more" if len(changed) > 1 else ""
        yield f"scene {first} has changed ({digests}){more}"


def _scenes(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    plural = "s" if len(names) > 1 else ""
    return f"scene{plural} {', '.join(names[:_NAMED])}{more} {'are' if plural else 'is'}"


def _simulator_faults(run: RunInfo, bank: SavedBank) -> Iterable[str]:
    ours, theirs = key_of(run).simulator, bank.manifest.key.simulator
    for name in sorted({*ours, *theirs}):
        if ours.get(name) != theirs.get(name):
            there = theirs.get(name, "none")
            yield f"its {name} is {ours.get(name, 'none')}, the baseline's {there}"
