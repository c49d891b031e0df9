"""What a policy showed, and what is wrong with it, as lines of text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from nw_eval.cards import Card, JointControl
from nw_eval.cards.joints import short_name
from nw_eval.catalogue import get_scene
from nw_eval.errors import PolicyError
from nw_eval.onboarding.probe.budget import Metered
from nw_eval.onboarding.probe.comparison import compare
from nw_eval.onboarding.probe.findings import (
    Range,
    action_findings,
    body_findings,
    input_findings,
    measure,
    observation_findings,
)
from nw_eval.onboarding.probe.following import Followed
from nw_eval.onboarding.probe.networks import network_findings, network_rows
from nw_eval.onboarding.probe.parts import parts_of
from nw_eval.onboarding.probe.recording import Recording
from nw_eval.onboarding.probe.rig import SceneRig
from nw_eval.policies import Bundle, load_bundle
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.rollout.check_bundle import check_bundle
from nw_eval.rollout.confined.access import running_rules
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.fault import PolicyFailedError

FLAT = "flat/carpet_room"
SECONDS = 1.0
BEYOND = (
    "beyond this check: a robot, pose, scale, frame, gain, torque limit, rate or delay that is not "
    "the training's, but with which it walks all the same"
)
"""What no second on the flat can show; said where no fault is found."""
_TIME_LIMIT = 600.0  # s of wall time
_BUDGET = 360.0
"""Seconds of simulation for commands and other cards. Measured on six policies under 140 cards:
2 to 186, which took up to 13 s."""


@dataclass(frozen=True, kw_only=True)
class ProbeReport:
    """What some seconds of a policy showed."""

    text: str
    passed: bool


def probe_policy(bundle: Bundle, *, scene: str = FLAT, allow_code: bool = False) -> ProbeReport:
    """Run a policy in a process of its own, and say what is odd.

    It runs for one second as its card says. In the flat room it is then commanded all ways, for
    two seconds each, and other cards are tried if it stumbles or misses a command.

    Raises:
        PolicyError, SceneError: it cannot be run at all, or fails as it runs.
    """
    sees = bool(bundle.card.splat_images)
    place = get_scene(scene)
    if sees and place.splat is not None:
        place.splat_store()  # The cache is out of that process's reach.
    answer = call_isolated(
        _probe,
        subject=str(bundle.card_path),
        rules=running_rules(bundle, scenes=[scene], allow_code=allow_code),
        time_limit=_TIME_LIMIT,
        renders=sees,
        card=str(bundle.card_path.resolve()),
        checkpoint=None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
        scene=scene,
        allow_code=allow_code,
    )
    return ProbeReport(text=str(answer["text"]), passed=bool(answer["passed"]))


def _probe(
    *, card: str, checkpoint: str | None, scene: str, allow_code: bool
) -> dict[str, str | bool]:
    bundle = load_bundle(card, checkpoint=None if checkpoint is None else Path(checkpoint))
    told = probe_here(bundle, scene=scene, allow_code=allow_code)
    return {"text": told.text, "passed": told.passed}


def probe_here(bundle: Bundle, *, scene: str = FLAT, allow_code: bool = False) -> ProbeReport:
    """As `probe_policy`, in this process: for checkpoints that one trusts.

    Raises:
        PolicyError, SceneError: it cannot be run at all, or fails as it runs.
    """
    # What begins in the first third of the time ends in time, even if a step takes 4 s.
    deadline = monotonic() + _TIME_LIMIT / 3.0
    card, robot = bundle.card, get_robot(bundle.card.robot)
    specs = check_bundle(bundle, robot, allow_code=allow_code)
    rig = SceneRig(bundle, scene=scene, allow_code=allow_code)
    try:
        recording = rig.record(card, seconds=SECONDS)
    except PolicyFailedError as error:
        raise PolicyError(f"{bundle.card_path}: {error}") from error
    ranges = [measure(part, recording) for part in parts_of(card, robot, specs)]
    followed: list[Followed] = []
    findings = [
        *observation_findings(ranges, recording),
        *input_findings(card, ranges, recording),
        *network_findings(card, recording),
        *action_findings(card, robot, recording),
        *body_findings(recording),
    ]
    if scene == FLAT:
        metered = Metered(rig, simulated=_BUDGET, deadline=deadline)
        followed, found = compare(metered, card, robot, recording)
        findings += found
    faults = sum(finding.kind == "fault" for finding in findings)
    lines = [
        f"{bundle.name}: {recording.seconds:.2f} s in {scene}, {recording.travelled:.2f} m",
        "",
        *observation_table(ranges),
        *network_table(card, recording),
        "",
        *action_table(card, robot, recording),
        "",
        *command_table(followed),
        *(f"{finding.kind}: {finding.text}" for finding in findings),
        *([BEYOND] if scene == FLAT and not faults else []),
        "no fault found" if not faults else f"{faults} {'fault' if faults == 1 else 'faults'}",
    ]
    return ProbeReport(text="\n".join(lines), passed=not faults)


def observation_table(ranges: list[Range]) -> list[str]:
    """Return a line for each term, with a heading."""
    rows = [("observation", "term", "numbers", "as", "min", "mean", "max", "constant")]
    for value in ranges:
        part = value.part
        frames = f" ({part.steps} frames)" if part.steps > 1 else ""
        rows.append(
            (
                part.observation,
                part.kind,
                f"{value.size}{frames}",
                part.form,
                f"{value.low:z.3f}",
                f"{value.mean:z.3f}",
                f"{value.high:z.3f}",
                f"{value.constant} of {value.size}" if value.constant else "",
            )
        )
    return aligned(rows, right={4, 5, 6})


def network_table(card: Card, recording: Recording) -> list[str]:
    """Return a line for each output of each network, after an empty line and a heading."""
    rows = network_rows(card, recording)
    return ["", *aligned(rows, right={4, 5, 6})] if rows else []


def action_table(card: Card, robot: RobotSpec, recording: Recording) -> list[str]:
    """Return a line for each joint, in the policy's order, with a heading."""
    torque = card.control.action == "joint_torque"
    unit = "N m" if torque else "rad"
    rows = [("joint", "action min", "mean", "max", f"target min, {unit}", "max", "torque max, N m")]
    try:
        order = JointControl.from_card(card, robot).order
    except PolicyError:
        return []
    for place, index in enumerate(order.tolist()):
        action, target = recording.actions[:, place], recording.targets[:, index]
        rows.append(
            (
                short_name(robot.joints[index]),
                f"{action.min():z.3f}",
                f"{action.mean():z.3f}",
                f"{action.max():z.3f}",
                f"{target.min():z.3f}",
                f"{target.max():z.3f}",
                f"{abs(recording.torques[:, index]).max():.1f}",
            )
        )
    return aligned(rows, right={1, 2, 3, 4, 5, 6})


def command_table(followed: list[Followed]) -> list[str]:
    """Return a line for each command, with a heading and an empty line behind; none for none."""
    if not followed:
        return []
    rows: list[tuple[str, ...]] = [("command", "asked", "reached", "share")]
    for one in followed:
        direction, asked, reached = one.words
        ending = ", fell" if one.fell else ", stumbled" if one.stumbled else ""
        rows.append((direction, asked, reached + ending, f"{one.ratio:z.2f}"))
    return [*aligned(rows, right={3}), ""]


def aligned(rows: list[tuple[str, ...]], *, right: set[int]) -> list[str]:
    """Return rows as lines whose columns are aligned."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
