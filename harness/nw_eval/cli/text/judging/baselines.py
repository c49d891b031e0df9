"""Banks as tables: all of them, and one scene by scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural
from nw_eval.results.bank.changes import bank_mean, mean_of

if TYPE_CHECKING:
    from nw_eval.api import ListedBaseline, ShownBaseline
    from nw_eval.results.bank import Panel, SavedBank, Start, Stratum

_NOTE = 60  # characters of a note in a table


def baseline_table(baselines: Sequence[ListedBaseline]) -> str:
    """Return a line for each baseline: name, policy, starts, mean, when, machines, note."""
    if not baselines:
        return "no baselines: neither shipped, nor in reports/baselines"
    heading = ("baseline", "policy", "starts", "mean", "saved", "machines", "note")
    names = Counter(_name(each) for each in baselines)
    rows = [
        heading,
        # Where a project's bank has the name of a shipped one, only the path says which.
        *(
            (_name(each) if names[_name(each)] == 1 else clean(each.file), *_line(each))
            for each in baselines
        ),
    ]
    return "\n".join(aligned(rows, right={3}))


def baseline_page(shown: ShownBaseline) -> str:
    """Return all that a baseline says of itself, and its scenes as a table."""
    return "\n".join([*_facts(shown), "", *aligned(list(_scenes(shown.bank)), right={1})])


def stratum_words(stratum: Stratum) -> str:
    """Return a scene with what was changed in it, such as `gaps/two friction=0.5`."""
    scene, cell = stratum
    return clean(" ".join([scene, *(f"{axis}={value:g}" for axis, value in cell)]), at_most=120)


def machine_words(machine: Mapping[str, str]) -> str:
    """Return a class of machine in one line, the processor first."""
    names = sorted(machine, key=lambda name: (name != "cpu", name))
    return clean(", ".join(f"{name} {machine[name]}" for name in names), at_most=300)


def _name(listed: ListedBaseline) -> str:
    return clean(f"{listed.suite}/{listed.name}")


def _line(listed: ListedBaseline) -> tuple[str, ...]:
    if listed.bank is None:
        return "?", "?", "?", "?", "?", clean(listed.problem)
    manifest = listed.bank.manifest
    return (
        clean(manifest.policy.name),
        f"{plural(len(manifest.key.scenes), 'scene')} x {manifest.starts}",
        f"{listed.mean:.3f}",
        clean(max(panel.saved for panel in manifest.panels))[:10],
        clean(", ".join(panel.machine.get("cpu", "?") for panel in manifest.panels), at_most=100),
        clean(manifest.note, at_most=_NOTE),
    )


def _facts(shown: ShownBaseline) -> Iterator[str]:
    manifest, bank = shown.bank.manifest, shown.bank
    simulator = ", ".join(f"{name} {value}" for name, value in manifest.key.simulator.items())
    policy = manifest.policy
    digests = f"checkpoint {policy.checkpoint_digest[:16]}, card {policy.card_digest[:16]}"
    yield f"baseline   {clean(manifest.name)}"
    yield f"file       {clean(shown.file)}"
    yield f"suite      {clean(manifest.suite)}"
    yield f"policy     {clean(policy.name)} ({clean(digests)})"
    yield f"starts     {manifest.starts} in each of {plural(len(manifest.key.scenes), 'scene')}"
    yield f"mean       {bank_mean(bank):.3f}"
    yield f"seed       {manifest.key.seed}, protocol {clean(manifest.key.protocol)}"
    yield f"simulator  {clean(simulator)}"
    if manifest.note:
        yield f"note       {clean(manifest.note)}"
    for number, (panel, info) in enumerate(zip(bank.panels, manifest.panels, strict=True), 1):
        by = f" by {clean(info.by)}" if info.by else ""
        yield f"panel {number}    {clean(info.saved)}{by}: {machine_words(info.machine)}"
        if number > 1:
            yield f"           {_against_first(panel, bank.panels[0])}"


def _against_first(panel: Panel, first: Panel) -> str:
    pairs = list(zip(panel.starts, first.starts, strict=True))
    moved = sum(a.trajectory != b.trajectory for a, b in pairs)
    return f"{moved} of {len(pairs)} starts went another way than on panel 1"


def _scenes(bank: SavedBank) -> Iterator[tuple[str, ...]]:
    yield "scene", "mean", "completed", "others"
    for stratum, starts in bank.panels[0].by_stratum.items():
        completed = sum(start.completed for start in starts)
        share = f"{completed} of {len(starts)}"
        yield stratum_words(stratum), f"{mean_of(starts):.3f}", share, _others(starts)


def _others(starts: Sequence[Start]) -> str:
    ends = Counter(start.outcome for start in starts if not start.completed)
    return ", ".join(f"{count} {clean(outcome)}" for outcome, count in ends.most_common())
