"""`nw-eval policies`: which there are, what a card says, if it is right, a first one, a hub's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import UsageError
from nw_base.plural import plural
from nw_eval.cli.terminal.interruption import stopped_by_signals
from nw_eval.cli.terminal.lines import aligned, fetched_lines
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import CardDraft, FoldedGraph
    from nw_policies.cards.load import ListedPolicy
    from nw_scenes.hub.reference import Fetched
    from nw_sim.probe.report import (
        ProbedCommand,
        ProbedJoint,
        ProbedOutput,
        ProbedTerm,
        ProbeReport,
    )
    from nw_sim.probe.summary import CardFile, CardJoint, CardSummary, CardTerm


@verb_of("list_policies")
class List(Printed, Verb):
    """List the available policies."""

    def show(self, result: Sequence[ListedPolicy]) -> str:
        return policy_table(result)


@verb_of("show_policy", changes=("checkpoint", "allow_code"))
class Show(Printed, Verb):
    """Show a card: all terms, joints, settings that are not defaults, and the checkpoint."""

    def show(self, result: CardSummary) -> str:
        return card_page(result)


@verb_of("check_policy", changes=("checkpoint", "allow_code"))
class Check(Printed, Verb):
    """Run a policy for a few seconds and check its terms, inputs, signs and orders.

    In the flat room, a policy with a velocity command is also commanded forward, sideways and in
    turns. If it stumbles or misses a command, other cards are tried. Prints `no fault found`, or
    each fault and what the card should say (exit code 2).
    """

    def show(self, result: ProbeReport) -> str:
        return probe_page(result)

    def code(self, result: ProbeReport) -> int:
        return 0 if result.passed else UsageError.exit_code


@verb_of("init_policy")
class Init(Verb):
    """Inspect a checkpoint, without running it, and write a first card beside it.

    Only a TorchScript file that hides the size of its one input is run, on zeros and confined.
    Missing information is read from files beside it, above it, or in `params`, `configs` or
    `io_descriptors`: deploy.yaml, IO_descriptors.yaml, env.yaml, agent.yaml, and the configs of
    rl_sar, legged_rl_deploy, unitree_rl_gym and others. The card names the source of each line.
    --out is a file; that of `robots init` is a folder.
    """

    def show(self, result: CardDraft) -> str:
        return f"{result.text}\n{result.file}: {plural(result.to_check, 'line')} to check"


@verb_of("fold_policy")
class Fold(Verb):
    """Write a checkpoint of several files as one file, without running it."""

    def show(self, result: FoldedGraph) -> str:
        return f"{result.file}: {result.bytes / 1e6:.2f} MB in one file"


@verb_of("serve_policy", changes=("checkpoint", "allow_code"), without=("confined",))
class Serve(Verb):
    """Serve a policy over a websocket, for `adapter: remote`, until SIGINT or SIGTERM."""

    def more(self) -> dict[str, Any]:
        return {"confined": True}

    def __call__(self) -> int:
        stop = stopped_by_signals()
        with self.call() as served:
            print(f"serving {served.name} at {served.url} (digest {served.digest})", flush=True)
            stop.wait()
        return 0


@verb_of("fetch_policy", named={"reference": "policy"})
class FetchPolicy(Verb):
    """Download a policy's current version from its hub.

    Runs then use this copy and need no network. Nothing is executed. Run the same command again to
    resume a download. HF_TOKEN or `hf auth login` sets the user, HF_ENDPOINT the hub. Needs the
    extra `hub`.
    """

    def show(self, result: Fetched) -> str:
        return fetched_lines(result)


def policy_table(policies: Sequence[ListedPolicy]) -> str:
    """Return a line for each policy: name, robot, adapter, title; or what is wrong."""
    if not policies:
        return "no policies: neither shipped, nor in ./policies"
    return "\n".join(aligned([(clean(each.name), *_words(each)) for each in policies]))


def _words(policy: ListedPolicy) -> tuple[str, str, str]:
    if policy.problem is not None:
        return "?", "?", policy.problem
    title = policy.title
    if policy.networks:
        title += f" (fed by {', '.join(policy.networks)})"
    if policy.missing is not None:
        title += f" (weights: {policy.missing or 'not here'})"
    return policy.robot, policy.adapter, title


def card_page(summary: CardSummary) -> str:
    """Return what a card says: each term, each joint, whatever is not by default, its files."""
    card = summary.card
    terms = [("observation", "term", "numbers", "as", "sampled"), *map(_card_term, summary.terms)]
    motor = "torque limit", "armature", "friction loss"
    joints = [("joint", "default", "scale", "kp", "kd", *motor), *map(_card_joint, summary.joints)]
    lines = [
        f"{card.name}: {card.title}" if card.title else card.name,
        f"card        {clean(summary.path)}",
        f"licence     {card.licence or 'not stated'}",
        f"robot       {card.robot}",
        f"adapter     {card.adapter}",
        *_card_files(summary),
        f"command     {summary.command}",
        *(f"{key:10}  {clean(value)}" for key, value in summary.options.items()),
        "",
        *aligned(terms),
        *_card_observations(summary),
        "",
        *summary.inputs,
        *([""] if summary.inputs else []),
        f"actions: {', '.join(summary.action)}",
        *aligned(joints, right=range(1, 8)),
    ]
    return "\n".join(line.rstrip() for line in lines)


def _card_files(summary: CardSummary) -> list[str]:
    lines = [
        f"{'network' if file.network else 'checkpoint':10}  {clean(_card_file(file))}"
        for file in summary.files
    ]
    own = any(not file.network for file in summary.files)
    return lines if own else ["checkpoint  none", *lines]


def _card_file(file: CardFile) -> str:
    words = f"{file.network}: {file.file}" if file.network else file.file
    if file.problem is not None:
        return f"{words}: not usable: {file.problem}"
    if not file.sha256:
        return words
    words += f", {file.bytes / 1e6:.2f} MB, SHA-256 {file.sha256[:16]}"
    if file.network:
        return f"{words}, {file.adapter}, {file.rate} Hz"
    return f"{words}, not the card's {file.declared[:16]}" if file.declared else words


def _card_observations(summary: CardSummary) -> list[str]:
    lines: list[str] = []
    for observation in summary.observations:
        settings = f"; {', '.join(observation.settings)}" if observation.settings else ""
        lines.append(f"  {clean(f'{observation.reckoning}{settings}')}")
    return lines


def _card_term(term: CardTerm) -> tuple[str, ...]:
    size = f"{term.numbers}"
    if term.frames > 1:
        size += f" ({term.frames} frames)"
    elif len(term.shape) > 1:
        size = " x ".join(str(side) for side in term.shape)
    return term.observation, term.term, size, term.form, f"{term.rate} Hz"


def _card_joint(joint: CardJoint) -> tuple[str, ...]:
    numbers = joint.default, joint.scale, joint.kp, joint.kd
    motor = joint.torque_limit, joint.armature, joint.friction_loss
    return joint.joint, *("" if n is None else f"{n:zg}" for n in (*numbers, *motor))


_Rows = list[tuple[str, ...]]


def probe_page(report: ProbeReport) -> str:
    """Return what a policy saw, gave and followed, and what is wrong with it."""
    networks = aligned(_probed_outputs(report.outputs), right={4, 5, 6})
    joints = _probed_joints(report.joints, unit="N m" if report.drives_torque else "rad")
    commands = aligned(_probed_commands(report.commands), right={3})
    faults = report.faults
    lines = [
        f"{report.policy}: {report.seconds:.2f} s in {report.scene}, {report.travelled:.2f} m",
        "",
        *aligned(_probed_terms(report.terms), right={4, 5, 6}),
        *([""] if networks else []),
        *networks,
        "",
        *aligned(joints, right={1, 2, 3, 4, 5, 6}),
        "",
        *commands,
        *([""] if commands else []),
        *([] if report.runtimes is None else [f"processor: {clean(report.runtimes.text)}"]),
        *(f"{finding.kind}: {finding.text}" for finding in report.findings),
        *([report.caveat] if report.caveat else []),
        "no fault found" if not faults else plural(faults, "fault"),
    ]
    return "\n".join(lines)


def _probed_terms(terms: Sequence[ProbedTerm]) -> _Rows:
    rows: _Rows = [("observation", "term", "numbers", "as", "min", "mean", "max", "constant")]
    for term in terms:
        frames = f" ({term.frames} frames)" if term.frames > 1 else ""
        names = term.observation, term.term, f"{term.numbers}{frames}", term.form
        rows.append((*names, *_span(term)))
    return rows


def _probed_outputs(outputs: Sequence[ProbedOutput]) -> _Rows:
    rows: _Rows = [("network", "gives", "numbers", "rate", "min", "mean", "max", "constant")]
    for output in outputs:
        names = output.network, output.output, f"{output.numbers}", f"{output.rate} Hz"
        rows.append((*names, *_span(output)))
    return rows if outputs else []


def _span(values: ProbedTerm | ProbedOutput) -> tuple[str, ...]:
    constant = f"{values.constant} of {values.numbers}" if values.constant else ""
    return f"{values.low:z.3f}", f"{values.mean:z.3f}", f"{values.high:z.3f}", constant


def _probed_joints(joints: Sequence[ProbedJoint], *, unit: str) -> _Rows:
    targets = f"target min, {unit}", "max", "torque max, N m"
    rows: _Rows = [("joint", "action min", "mean", "max", *targets)]
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


def _probed_commands(commands: Sequence[ProbedCommand]) -> _Rows:
    rows: _Rows = [("command", "commanded", "reached", "share")]
    for each in commands:
        commanded, reached = f"{each.commanded:g} {each.unit}", f"{each.reached:z.2f} {each.unit}"
        ending = ", fell" if each.fell else ", stumbled" if each.stumbled else ""
        rows.append((each.command, commanded, reached + ending, f"{each.share:z.2f}"))
    return rows if commands else []
