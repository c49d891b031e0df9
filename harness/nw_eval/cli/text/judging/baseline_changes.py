"""What differs between baselines, or between a baseline and what it would be here, in lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from shlex import quote
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.cli.text.judging.baselines import machine_words, stratum_words
from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural
from nw_eval.results.bank.changes import bank_mean

if TYPE_CHECKING:
    from nw_eval.api import CheckedBaseline, SavedBaseline, VerifiedBaseline
    from nw_eval.results.bank.changes import BankChange, FieldChange, SceneChange

_FLIPPED = 8  # indexes of starts that a cell names


def change_page(change: BankChange) -> str:
    """Return what differs between two baselines: fields, then scenes, then whose doing it is."""
    fields = [*change.fields, *change.machine]
    scenes = [_HEADING, *(_scene(each) for each in change.scenes), _mean(change)]
    parts = [field_lines(fields), aligned(scenes, right={1, 2, 3}), [whose_doing(change)]]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def field_lines(fields: Sequence[FieldChange]) -> list[str]:
    """Return a line for each field: what it is of, its name, then and now."""
    return aligned(
        [
            (f"{each.part} {clean(each.name)}", f"{clean(each.then)} -> {clean(each.now)}")
            for each in fields
        ]
    )


def whose_doing(change: BankChange) -> str:
    """Return what may be charged with what moved: the policy, something else, or neither."""
    moved = any(scene.moved for scene in change.scenes)
    others = sorted(change.parts - {"policy"}) + (["machine"] if change.machine else [])
    if not moved:
        return "No start went another way."
    if "policy" not in change.parts:
        cause = " and ".join(others) or "something that no field names"
        return f"The policy is the same: what moved is the doing of the {cause}, of no checkpoint."
    if not others:
        return "Only the policy differs: what moved is its doing."
    return (
        f"The policy differs, and so does the {' and '.join(others)}: what moved can be charged to "
        "none of them alone. Renew the baseline with the earlier policy first, and compare that."
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
    name, starts = verified.bank.manifest.name, len(verified.bank.panels[0].starts)
    yield from verified.differing
    yield from (f"no result now: {fault}" for fault in verified.faults)
    if verified.differing:
        count = len(verified.differing)
        verb = "differs" if count == 1 else "differ"
        yield f"INVALID: {plural(count, 'row')} of baseline {name} {verb}"
        if not verified.has_panel:
            yield (
                "it has not been run on this class of machine, whose bits may be others: run it "
                "where it was saved, or save it here"
            )
    equal = verified.ran - len(verified.differing)
    yield (
        f"run again: {equal} of {plural(verified.drawn, 'trial')} as the baseline says, values and "
        f"bits, drawn from {starts} by --seed {verified.seed}"
    )


_HEADING = ("scene", "then", "now", "change", "went another way", "ended or scored otherwise")


def _scene(change: SceneChange) -> tuple[str, ...]:
    words = stratum_words((change.scene, change.perturbation))
    if change.then is None or change.now is None:
        then, now = (_number(value) for value in (change.then, change.now))
        return words, then, now, "", "", ""
    return (
        words,
        _number(change.then),
        _number(change.now),
        f"{change.now - change.then:+.3f}",
        f"{change.moved} of {change.starts}",
        _flipped(change),
    )


def _mean(change: BankChange) -> tuple[str, ...]:
    then, now = bank_mean(change.then), bank_mean(change.now)
    return "mean", _number(then), _number(now), f"{now - then:+.3f}", "", ""


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"


def _flipped(change: SceneChange) -> str:
    if not change.flipped:
        return "none"
    named = ", ".join(str(index) for index in change.flipped[:_FLIPPED])
    more = f" and {len(change.flipped) - _FLIPPED} more" if len(change.flipped) > _FLIPPED else ""
    return f"starts {named}{more}"


def _saved(saved: SavedBaseline) -> Iterator[str]:
    manifest = saved.bank.manifest
    size = f"{plural(len(manifest.key.scenes), 'scene')} x {plural(manifest.starts, 'start')}"
    whole = f"{size}, mean success {bank_mean(saved.bank):.3f}"
    if saved.change is not None and saved.action != "unchanged":
        yield change_page(saved.change)
        yield ""
    if saved.action == "new":
        yield f"saved {saved.file}: {whole}, {saved.file.stat().st_size / 1000:.1f} kB"
    elif saved.action == "unchanged":
        yield f"{saved.file} has all of this already: {whole}"
    elif saved.action == "panel":
        machine = machine_words(manifest.panels[-1].machine)
        panels = plural(len(manifest.panels), "panel")
        yield f"saved {saved.file}, which has this class of machine now, too ({panels}): {machine}"
    elif saved.action == "renewed":
        yield f"renewed {saved.file}: {whole}"
    else:
        yield f"{saved.file} is as it was; --renew replaces it"


def _checked(checked: CheckedBaseline) -> Iterator[str]:
    manifest = checked.bank.manifest
    save = f"nw-eval baseline save {quote(checked.suite)} --policy {quote(checked.policy)}"
    if manifest.name != manifest.policy.name:
        save += f" --name {quote(manifest.name)}"
    if checked.changes:
        yield f"INVALID: baseline {clean(manifest.name)} does not hold here"
        yield from field_lines(checked.changes)
        yield f"renew it with `{clean(save)} --renew`"
        return
    yield f"baseline {clean(manifest.name)} holds here: suite, scenes, protocol, simulator" + (
        ", policy" if checked.unchecked is None else ""
    )
    if checked.unchecked is not None:
        yield f"its policy was not compared: {clean(checked.unchecked)}"
    if checked.has_panel:
        yield "it has a panel of this class of machine"
        return
    yield "it has no panel of this class of machine; its first one differs in:"
    yield from field_lines(checked.machine)
    yield f"add one with `{clean(save)}`"
