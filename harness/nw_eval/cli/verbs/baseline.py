"""`nw-eval baseline`: what a policy scores from every start, saved to be compared with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import IncomparableError
from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import (
        CheckedBaseline,
        ListedBaseline,
        SavedBaseline,
        ShownBaseline,
        VerifiedBaseline,
    )
    from nw_gate.results.baseline import (
        BaselineChange,
        BaselineResults,
        FieldChange,
        Panel,
        SceneChange,
        Start,
        Stratum,
    )


@verb_of(
    "save_baseline",
    changes=(
        *("suite", "checkpoint", "robot", "render", "time_limit", "memory_limit", "allow_code"),
        *("workers", "no_cache"),
    ),
    without=("root",),
    listens=True,
)
class Save(Verb):
    """Run the trials a baseline needs and save it as reports/baselines/<suite>/<name>.parquet.

    Prints an estimate first. Run the same command again to resume. Adds this machine type to an
    existing baseline. If the suite or scenes changed, --renew is required and the changes are shown
    (exit code 5 without it).
    """

    run: Path | None

    def show(self, result: SavedBaseline) -> str:
        return saved_page(result)

    def code(self, result: SavedBaseline) -> int:
        return IncomparableError.exit_code if result.action == "kept" else 0


@verb_of("list_baselines")
class List(Printed, Verb):
    """List the project's baselines and the shipped ones."""

    def show(self, result: Sequence[ListedBaseline]) -> str:
        return baseline_table(result)


@verb_of("show_baseline")
class Show(Printed, Verb):
    """Show what a baseline was saved for, by whom and why, and its results by scene."""

    def show(self, result: ShownBaseline) -> str:
        return baseline_page(result)


@verb_of("check_baseline", changes=("checkpoint", "render", "allow_code"))
class Check(Printed, Verb):
    """Check whether a baseline is compatible: suite, scenes, protocol, simulator, policy.

    Exit code 5 if it is not. Also shows whether it has results for this machine type.
    """

    def show(self, result: CheckedBaseline) -> str:
        return checked_page(result)


@verb_of(
    "verify_baseline",
    changes=("checkpoint", "render", "allow_code", "workers"),
    metavars={"trials": "N%|N"},
    listens=True,
)
class Verify(Printed, Verb):
    """Re-run some of a baseline's trials with its own policy and name each difference.

    The trials are drawn at random. Exit code 5 if a result differs, 4 if a trial has no result. The
    project is not changed.
    """

    goes_on = "interrupted; not all of the trials that were drawn have run"

    def show(self, result: VerifiedBaseline) -> str:
        return verified_page(result)


@verb_of("diff_baselines")
class Diff(Printed, Verb):
    """Compare two baselines: settings, means by scene, and trials that ended differently."""

    def show(self, result: BaselineChange) -> str:
        return change_page(result)


_NOTE = 60  # characters of a note in a table


def baseline_table(baselines: Sequence[ListedBaseline]) -> str:
    """Return a line for each baseline: name, policy, starts, mean, when, machines, note."""
    if not baselines:
        return "no baselines: neither shipped, nor in reports/baselines"
    heading = ("baseline", "policy", "initial states", "mean", "saved", "machines", "note")
    names = Counter(_name(each) for each in baselines)
    rows = [
        heading,
        # Where a project's baseline has the name of a shipped one, only the path says which.
        *(
            (_name(each) if names[_name(each)] == 1 else clean(each.file), *_line(each))
            for each in baselines
        ),
    ]
    return "\n".join(aligned(rows, right={3}))


def baseline_page(shown: ShownBaseline) -> str:
    """Return all that a baseline says of itself, and its scenes as a table."""
    return "\n".join([*_facts(shown), "", *aligned(list(_scenes(shown.baseline)), right={1})])


def stratum_words(stratum: Stratum) -> str:
    """Return a scene with what was changed in it, such as `gaps/two friction=0.5`."""
    scene, cell = stratum
    return clean(" ".join([scene, *(f"{axis}={value:g}" for axis, value in cell)]), at_most=120)


def machine_words(machine: Mapping[str, str]) -> str:
    """Return a machine type in one line, the processor first."""
    names = sorted(machine, key=lambda name: (name != "cpu", name))
    return clean(", ".join(f"{name} {machine[name]}" for name in names), at_most=300)


def _name(listed: ListedBaseline) -> str:
    return clean(f"{listed.suite}/{listed.name}")


def _line(listed: ListedBaseline) -> tuple[str, ...]:
    if listed.baseline is None:
        return "?", "?", "?", "?", "?", clean(listed.problem)
    manifest = listed.baseline.manifest
    return (
        clean(manifest.policy.name),
        f"{plural(len(manifest.key.scenes), 'scene')} x {manifest.starts}",
        f"{listed.mean:.3f}",
        clean(max(panel.saved for panel in manifest.panels))[:10],
        clean(", ".join(panel.machine.get("cpu", "?") for panel in manifest.panels), at_most=100),
        clean(manifest.note, at_most=_NOTE),
    )


def _facts(shown: ShownBaseline) -> Iterator[str]:
    from nw_gate.limits.limit import Limit
    from nw_gate.results.baseline import baseline_mean

    manifest, baseline = shown.baseline.manifest, shown.baseline
    simulator = ", ".join(f"{name} {value}" for name, value in manifest.key.simulator.items())
    policy = manifest.policy
    digests = f"checkpoint {policy.checkpoint_digest[:16]}, card {policy.card_digest[:16]}"
    yield f"baseline   {clean(manifest.name)}"
    yield f"file       {clean(shown.file)}"
    yield f"suite      {clean(manifest.suite)}"
    if manifest.held_out:
        yield "seed set   held out: it was not used to choose the policy"
    yield f"policy     {clean(policy.name)} ({clean(digests)})"
    scenes = plural(len(manifest.key.scenes), "scene")
    yield f"states     {manifest.starts} initial states in each of {scenes}"
    yield f"mean       {baseline_mean(baseline):.3f}"
    yield f"seed       {manifest.key.seed}, protocol {clean(manifest.key.protocol)}"
    yield f"simulator  {clean(simulator)}"
    for ladder, saved in manifest.limits.items():
        limit = Limit.from_dict(saved.limit)
        trials = plural(len(limit.trials), "trial")
        yield f"limit      {clean(ladder)}: {clean(limit.range_text)} ({trials})"
    if manifest.note:
        yield f"note       {clean(manifest.note)}"
    for number, (panel, info) in enumerate(zip(baseline.panels, manifest.panels, strict=True), 1):
        by = f" by {clean(info.by)}" if info.by else ""
        yield f"machine {number}  {clean(info.saved)}{by}: {machine_words(info.machine)}"
        if number > 1:
            yield f"           {_against_first(panel, baseline.panels[0])}"


def _against_first(panel: Panel, first: Panel) -> str:
    pairs = list(zip(panel.starts, first.starts, strict=True))
    moved = sum(a.trajectory != b.trajectory for a, b in pairs)
    return f"{moved} of {len(pairs)} trials differ from machine 1"


def _scenes(baseline: BaselineResults) -> Iterator[tuple[str, ...]]:
    from nw_gate.results.baseline import mean_of

    yield "scene", "mean", "completed", "others"
    for stratum, starts in baseline.panels[0].by_stratum.items():
        completed = sum(start.completed for start in starts)
        share = f"{completed} of {len(starts)}"
        yield stratum_words(stratum), f"{mean_of(starts):.3f}", share, _others(starts)


def _others(starts: Sequence[Start]) -> str:
    ends = Counter(start.outcome for start in starts if not start.completed)
    return ", ".join(f"{count} {clean(outcome)}" for outcome, count in ends.most_common())


_FLIPPED = 8  # indexes of starts that a cell names


def change_page(change: BaselineChange) -> str:
    """Return what differs between two baselines: fields, then scenes, then whose doing it is."""
    fields = [*change.fields, *change.machine]
    scenes = [
        _HEADING,
        *(_scene(each) for each in change.scenes),
        _mean(change),
    ]
    parts = [
        field_lines(fields),
        aligned(scenes, right={1, 2, 3}),
        aligned(_limits(change)),
        [whose_doing(change)],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _limits(change: BaselineChange) -> list[tuple[str, ...]]:
    """Return a row for each ladder that one of two baselines has a limit on."""
    from nw_gate.limits.limit import Limit

    both = [each.manifest.limits for each in (change.then, change.now)]
    rows = [
        (
            clean(ladder),
            *(
                clean(Limit.from_dict(x[ladder].limit).range_text) if ladder in x else "none"
                for x in both
            ),
        )
        for ladder in sorted({*both[0], *both[1]})
    ]
    return [("limit", "then", "now"), *rows] if rows else []


def field_lines(fields: Sequence[FieldChange]) -> list[str]:
    """Return a line for each field: what it is of, its name, then and now."""
    return aligned(
        [
            (f"{each.part} {clean(each.name)}", f"{clean(each.then)} -> {clean(each.now)}")
            for each in fields
        ]
    )


def whose_doing(change: BaselineChange) -> str:
    """Return what may be charged with what moved: the policy, something else, or neither."""
    limits = [
        {ladder: saved.limit for ladder, saved in each.manifest.limits.items()}
        for each in (change.then, change.now)
    ]
    moved = any(scene.moved for scene in change.scenes) or limits[0] != limits[1]
    others = sorted(change.parts - {"policy"}) + (["machine"] if change.machine else [])
    if not moved:
        return "No trial changed."
    if "policy" not in change.parts:
        cause = f"the {' and '.join(others)}" if others else "an unrecorded cause"
        return f"The policy is the same: the changes come from {cause}, not a checkpoint."
    if not others:
        return "Only the policy differs: the changes come from it."
    return (
        f"The policy and the {' and '.join(others)} differ: the changes cannot be attributed to "
        "one of them. Renew the baseline with the earlier policy first, and compare that."
    )


def saved_page(saved: SavedBaseline) -> str:
    """Return what became of a baseline that was to be saved."""
    return "\n".join(_saved(saved))


def checked_page(checked: CheckedBaseline) -> str:
    """Return whether a baseline holds here, with a line for each field that does not match."""
    return "\n".join(_checked(checked))


def verified_page(verified: VerifiedBaseline) -> str:
    """Return what starts that ran again came to, with a line for each row that differs."""
    return "\n".join(clean(line, at_most=1000) for line in _verified(verified))


def _verified(verified: VerifiedBaseline) -> Iterator[str]:
    manifest = verified.baseline.manifest
    name, starts = manifest.name, len(verified.baseline.panels[0].starts)
    kept = starts + sum(len(each.limit["trials"]) for each in manifest.limits.values())
    yield from verified.differing
    yield from (f"no result now: {fault}" for fault in verified.faults)
    if verified.differing:
        count = len(verified.differing)
        verb = "differs" if count == 1 else "differ"
        yield f"INVALID: {plural(count, 'row')} of baseline {name} {verb}"
        if not verified.has_panel:
            yield (
                "it has no results for this machine type, which may compute slightly different "
                "ones: verify it where it was saved, or save it here"
            )
    equal = verified.ran - len(verified.differing)
    yield (
        f"re-run: {equal} of {plural(verified.drawn, 'trial')} are identical to the baseline, "
        f"drawn from {kept} by --seed {verified.seed}"
    )


_HEADING = (
    "scene",
    "then",
    "now",
    "change",
    "trials changed",
    "ended or scored differently",
)


def _scene(change: SceneChange) -> tuple[str, ...]:
    words = stratum_words((change.scene, change.perturbation))
    if change.then is None or change.now is None:
        before, after = (_number(value) for value in (change.then, change.now))
        return words, before, after, "", "", ""
    return (
        words,
        _number(change.then),
        _number(change.now),
        f"{change.now - change.then:+.3f}",
        f"{change.moved} of {change.starts}",
        _flipped(change),
    )


def _mean(change: BaselineChange) -> tuple[str, ...]:
    from nw_gate.results.baseline import baseline_mean

    before, after = baseline_mean(change.then), baseline_mean(change.now)
    return "mean", _number(before), _number(after), f"{after - before:+.3f}", "", ""


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"


def _flipped(change: SceneChange) -> str:
    if not change.flipped:
        return "none"
    named = ", ".join(str(index) for index in change.flipped[:_FLIPPED])
    more = f" and {len(change.flipped) - _FLIPPED} more" if len(change.flipped) > _FLIPPED else ""
    return f"states {named}{more}"


def _saved(saved: SavedBaseline) -> Iterator[str]:
    from nw_gate.limits.limit import Limit
    from nw_gate.results.baseline import baseline_mean

    manifest = saved.baseline.manifest
    size = (
        f"{plural(len(manifest.key.scenes), 'scene')} x {plural(manifest.starts, 'initial state')}"
    )
    whole = f"{size}, mean success {baseline_mean(saved.baseline):.3f}"
    if saved.change is not None and saved.action != "unchanged":
        yield change_page(saved.change)
        yield ""
    if saved.action == "new":
        yield f"saved {saved.file}: {whole}, {saved.file.stat().st_size / 1000:.1f} kB"
    elif saved.action == "unchanged":
        yield f"{saved.file} already has these results: {whole}"
    elif saved.action == "panel":
        machine = machine_words(manifest.panels[-1].machine)
        classes = plural(len(manifest.panels), "type")
        yield f"saved {saved.file}, which has this machine type now, too ({classes}): {machine}"
    elif saved.action == "limits":
        yield f"saved {saved.file}, which has limits on ladders now, too"
    elif saved.action == "renewed":
        yield f"renewed {saved.file}: {whole}"
    else:
        yield f"{saved.file} did not change; --renew replaces it"
    for ladder, saved_limit in manifest.limits.items():
        yield f"limit of {clean(ladder)}: {clean(Limit.from_dict(saved_limit.limit).range_text)}"
    if saved.run is not None:
        run = str(saved.run)
        yield f"results and logs: {clean(run)}; report: nw-eval report {clean(quote(run))}"
    if saved.may_have_chosen:
        yield (
            "note: this run is of a watched training; if you chose the checkpoint by its success, "
            "the success is overstated: save the baseline with --policy, --checkpoint and "
            "--held-out instead of --run"
        )


def _checked(checked: CheckedBaseline) -> Iterator[str]:
    manifest = checked.baseline.manifest
    save = f"nw-eval baseline save {quote(checked.suite)} --policy {quote(checked.policy)}"
    if manifest.name != manifest.policy.name:
        save += f" --name {quote(manifest.name)}"
    if checked.changes:
        yield f"INVALID: baseline {clean(manifest.name)} is not compatible"
        yield from field_lines(checked.changes)
        yield f"renew it with `{clean(save)} --renew`"
        return
    yield f"baseline {clean(manifest.name)} is compatible: suite, scenes, protocol, simulator" + (
        ", policy" if checked.unchecked is None else ""
    )
    if checked.unchecked is not None:
        yield f"its policy was not compared: {clean(checked.unchecked)}"
    if checked.has_panel:
        yield "it has results for this machine type"
        return
    yield "it has no results for this machine type; its first machine differs in:"
    yield from field_lines(checked.machine)
    yield f"add one with `{clean(save)}`"
