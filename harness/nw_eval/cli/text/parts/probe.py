"""What a check of a policy showed, as tables and findings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.onboarding.probe.report import (
        ProbedCommand,
        ProbedJoint,
        ProbedOutput,
        ProbedTerm,
        ProbeReport,
    )

Rows = list[tuple[str, ...]]


def probe_page(report: ProbeReport) -> str:
    """Return what a policy saw, gave and followed, and what is wrong with it."""
    networks = aligned(_outputs(report.outputs), right={4, 5, 6})
    joints = _joints(report.joints, unit="N m" if report.drives_torque else "rad")
    commands = aligned(_commands(report.commands), right={3})
    faults = report.faults
    lines = [
        f"{report.policy}: {report.seconds:.2f} s in {report.scene}, {report.travelled:.2f} m",
        "",
        *aligned(_terms(report.terms), right={4, 5, 6}),
        *([""] if networks else []),
        *networks,
        "",
        *aligned(joints, right={1, 2, 3, 4, 5, 6}),
        "",
        *commands,
        *([""] if commands else []),
        *(f"{finding.kind}: {finding.text}" for finding in report.findings),
        *([report.caveat] if report.caveat else []),
        "no fault found" if not faults else plural(faults, "fault"),
    ]
    return "\n".join(lines)


def _terms(terms: Sequence[ProbedTerm]) -> Rows:
    rows: Rows = [("observation", "term", "numbers", "as", "min", "mean", "max", "constant")]
    for term in terms:
        frames = f" ({term.frames} frames)" if term.frames > 1 else ""
        names = term.observation, term.term, f"{term.numbers}{frames}", term.form
        rows.append((*names, *_span(term)))
    return rows


def _outputs(outputs: Sequence[ProbedOutput]) -> Rows:
    rows: Rows = [("network", "gives", "numbers", "rate", "min", "mean", "max", "constant")]
    for output in outputs:
        names = output.network, output.output, f"{output.numbers}", f"{output.rate} Hz"
        rows.append((*names, *_span(output)))
    return rows if outputs else []


def _span(values: ProbedTerm | ProbedOutput) -> tuple[str, ...]:
    constant = f"{values.constant} of {values.numbers}" if values.constant else ""
    return f"{values.low:z.3f}", f"{values.mean:z.3f}", f"{values.high:z.3f}", constant


def _joints(joints: Sequence[ProbedJoint], *, unit: str) -> Rows:
    targets = f"target min, {unit}", "max", "torque max, N m"
    rows: Rows = [("joint", "action min", "mean", "max", *targets)]
    rows += [
        (
            each.joint,
            f"{each.action_low:z.3f}",
            f"{each.action_mean:z.3f}",
            f"{each.action_high:z.3f}",
            f"{each.target_low:z.3f}",
            f"{each.target_high:z.3f}",
            f"{each.torque:.1f}",
        )
        for each in joints
    ]
    return rows if joints else []


def _commands(commands: Sequence[ProbedCommand]) -> Rows:
    rows: Rows = [("command", "commanded", "reached", "share")]
    for each in commands:
        commanded, reached = f"{each.commanded:g} {each.unit}", f"{each.reached:z.2f} {each.unit}"
        ending = ", fell" if each.fell else ", stumbled" if each.stumbled else ""
        rows.append((each.command, commanded, reached + ending, f"{each.share:z.2f}"))
    return rows if commands else []
