"""What is wrong with a recording, in words, and which other card its policy would follow best.

A policy under its own card walks nearly level, and does what it is commanded; with the joints in
another order it stumbles within a second. So the change that brings it nearest to its commands is
most likely the mistake. How near that is depends on the policy: some turn at 0.7 of what they are
told under their own cards.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NwEvalError, SceneError, nearest
from nw_base.plural import plural
from nw_places.entries import parted
from nw_policies.cards import Card, motors_follow
from nw_policies.cards.card import LEFT_OUT, ConstantCommand
from nw_policies.cards.feeding import resolve_inputs
from nw_policies.cards.joints import all_joints, short_name
from nw_policies.cards.networks import input_parts
from nw_policies.cards.observations import ProprioObservation, SplatRgbObservation
from nw_scenes.robots import RobotSpec
from nw_sim.catalogue import is_meant, rungs_meant
from nw_sim.catalogue import names as scene_names
from nw_sim.probe.following import (
    Followed,
    Motion,
    deviation,
    finds_its_way,
    follow,
    motions,
    own_way,
    stands_still,
)
from nw_sim.probe.hypotheses import (
    TRIED,
    Hypothesis,
    double_hypotheses,
    hypotheses,
    scale_hypotheses,
)
from nw_sim.probe.recording import (
    STUMBLES,
    Metered,
    Recording,
    Rig,
    SpentError,
    Walk,
)
from nw_sim.probe.summary import Part

Array = NDArray[np.float64]

_OFTEN = 0.2  # Share of control steps from which on a limit is a fault, not a moment.
_MOVES = 0.05  # rad; a target that moves less tells nothing of how its joint follows.
_LARGE = 30.0  # No scaled observation of a policy that learned is larger for long.
_MAY_REST = {
    "foot_contacts",
    "applied_action",
    "last_output",
    "speed",
    "command",
    "direction",
    "clock",
}


@dataclass(frozen=True, kw_only=True)
class ProbeFinding:
    """Something that a person should know."""

    kind: Literal["fault", "note"]
    text: str


@dataclass(frozen=True, kw_only=True)
class Range:
    """A part's numbers over the second."""

    part: Part
    low: float
    mean: float
    high: float
    constant: int
    """How many of its numbers never changed."""
    broken: int
    """How many values were NaN or infinite."""

    @property
    def size(self) -> int:
        """How many numbers the policy gets of it."""
        return len(self.part.indices)


def card_findings(card: Card) -> Iterator[ProbeFinding]:
    """Yield names in `trained_on` that are of no built-in scene: they mark no scene as trained in.

    Scenes of one's own (a path, `hub:`, `real:`) belong to no split, whether they are named or not.
    """
    for words in card.trained_on:
        pattern, _ = parted(words.removeprefix(LEFT_OUT))
        if pattern[:1] in ".~/" or (":" in pattern and not pattern.startswith("split:")):
            continue
        if not _is_known(pattern):
            hint = nearest(pattern, scene_names())
            guess = f"; {hint}" if hint.startswith("did you mean") else ""
            text = f"`trained_on`: {words!r} names no built-in scene, and marks none as trained in"
            yield ProbeFinding(kind="note", text=f"{text}{guess}")


def _is_known(pattern: str) -> bool:
    """Whether a pattern means a built-in scene, or a rung of a built-in ladder."""
    try:
        rungs = rungs_meant(pattern)
    except SceneError:  # The ladder has no such rung.
        return False
    return bool(rungs) or any(is_meant(name, pattern) for name in scene_names())


def measure(part: Part, recording: Recording) -> Range:
    """Return the range of a part; of what is finite."""
    whole = recording.observations[part.observation]
    values = whole.reshape(len(whole), -1)[:, part.indices].astype(np.float64)
    finite = values[np.isfinite(values)]
    if not finite.size:
        finite = np.full(1, np.nan)
    return Range(
        part=part,
        low=float(finite.min()),
        mean=float(finite.mean()),
        high=float(finite.max()),
        constant=int((values == values[:1]).all(axis=0).sum()),
        broken=int(values.size - np.isfinite(values).sum()),
    )


def observation_findings(ranges: list[Range], recording: Recording) -> list[ProbeFinding]:
    """Return what is odd about the observations."""
    findings: list[ProbeFinding] = []
    for value in ranges:
        part = value.part
        name = f"`{part.observation}`" + (f", {part.kind}" if part.kind else "")
        if value.broken:
            kind = "note" if part.kind == "lidar" else "fault"
            findings.append(
                ProbeFinding(kind=kind, text=f"{name}: {value.broken} of its values are NaN or inf")
            )
        if value.constant == value.size and not part.is_fixed:
            kind = "note" if part.kind in _MAY_REST else "fault"
            text = f"{name}: dead, it reads {value.mean:z.4g} from beginning to end"
            findings.append(ProbeFinding(kind=kind, text=text))
        largest = max(abs(value.low), abs(value.high))
        if part.limits is not None and _share_at(part, recording) > _OFTEN:
            low, high = part.limits
            text = f"{name}: its limits {low:g}..{high:g} clip it in most steps; check its scale"
            findings.append(ProbeFinding(kind="fault", text=text))
        elif largest > _LARGE and part.kind in _TERMS_OF_ORDER_ONE:
            text = f"{name}: reaches {largest:.3g}; a scale may be missing"
            findings.append(ProbeFinding(kind="note", text=text))
    return findings


def input_findings(card: Card, ranges: list[Range], recording: Recording) -> list[ProbeFinding]:
    """Return which inputs are not what a checkpoint is likely to have been trained on."""
    findings: list[ProbeFinding] = []
    files = [(card, recording.inputs)]
    files += [(card.of_network(name), specs) for name, specs in recording.fed_inputs.items()]
    for file, specs in files:
        for spec, names in resolve_inputs(file, specs) if specs else ():
            for name in (one for one in names if one in card.observations):
                is_rgb = isinstance(card.observations[name], SplatRgbObservation)
                is_bytes = recording.observations[name].dtype == np.uint8
                if is_rgb and is_bytes and spec.dtype.kind == "f":
                    text = f"`{name}` gives bytes 0..255 to a {spec.dtype} input; "
                    findings.append(
                        ProbeFinding(kind="note", text=f"{text}`dtype: float32` gives 0..1")
                    )
    zeros: dict[str, int] = {}
    for value in ranges:
        name, observation = value.part.observation, card.observations[value.part.observation]
        is_listed = isinstance(observation, ProprioObservation) and observation.terms is not None
        if is_listed and value.part.kind == "constant" and value.low == value.high == 0.0:
            zeros[name] = zeros.get(name, 0) + value.size
    rests = recording.travelled < _AT_REST * recording.seconds
    is_told = any(value.part.kind in _WHERE_TO for value in ranges)
    for name, count in zeros.items():
        text = (
            f"`{name}` holds {plural(count, 'zero')} instead of what the checkpoint was trained on"
        )
        if rests and not is_told:
            text += ", and it does not move ahead: name the term with its goal, such as `command`"
        kind = "fault" if rests and not is_told else "note"
        findings.append(ProbeFinding(kind=kind, text=text))
    return findings


_WHERE_TO = {"command", "delta_yaw", "speed"}
_AT_REST = 0.2
"""Metres a second below which a robot does not go on; courses are walked at 0.8."""
_TERMS_OF_ORDER_ONE = {"joint_pos", "joint_vel", "ang_vel", "lin_vel", "gravity", "last_output"}


def network_findings(card: Card, recording: Recording, ranges: list[Range]) -> list[ProbeFinding]:
    """Return which networks do not react to their inputs."""
    findings: list[ProbeFinding] = []
    for name, output in network_outputs(card):
        values = recording.fed[output]
        if len(values) > 1 and (values == values[:1]).all():
            parts = {part for _, own in input_parts(card.networks[name].inputs) for part in own}
            own = [value for value in ranges if value.part.observation in parts]
            # What other networks feed it is not looked at here.
            own = own if parts <= set(card.observations) else []
            text = f"network `{name}`: `{output}` is the same at every step: {_blame(own)}"
            findings.append(ProbeFinding(kind="fault", text=text))
    return findings


def network_outputs(card: Card) -> Iterator[tuple[str, str]]:
    """Yield every output of a network after the name of the network."""
    for name, network in card.networks.items():
        for output in network.given_as(name):
            yield name, output


def action_findings(
    card: Card, robot: RobotSpec, recording: Recording, fed: Sequence[Range] = ()
) -> list[ProbeFinding]:
    """Return what is odd about the actions and what the motors made of them.

    Args:
        card: under which it acts.
        robot: that it drives.
        recording: of it.
        fed: the parts of what it is fed; where it always acts alike they tell whose fault it is.
    """
    findings: list[ProbeFinding] = []
    actions = recording.actions
    if (actions == actions[:1]).all() and card.adapter != "zero":
        text = f"the action is the same at every step: {_blame(fed)}"
        findings.append(ProbeFinding(kind="fault", text=text))
    if card.control.clip is not None:
        low, high = card.control.clip
        cut = ((actions <= low) | (actions >= high)).mean(axis=0)
        order = all_joints(card.control.joints, card.control.held, robot.joints)
        findings += _by_joint(
            cut, order, f"the action is at its limits {low:g}..{high:g} (`control.clip`)"
        )
    if not card.control.has_torques:
        ranges = np.array(robot.joint_ranges)
        turned = np.array(motors_follow(card, robot)) == "position"
        outside = (recording.targets < ranges[:, 0]) | (recording.targets > ranges[:, 1])
        outside &= turned
        findings += _by_joint(
            outside.mean(axis=0), robot.joints, "the target is beyond the joint's range", note=True
        )
        if recording.stumbles:
            findings += _against(robot, recording)
    strained = np.abs(recording.torques) >= 0.999 * recording.torque_limits
    findings += _by_joint(strained.mean(axis=0), robot.joints, "the motor is at its torque limit")
    return findings


def _blame(ranges: Sequence[Range]) -> str:
    """Say whether a network that gives the same at every step is fed anything that changes."""
    fed = sum(value.size for value in ranges)
    constant = sum(value.constant for value in ranges)
    if fed and constant == fed:
        return (
            f"all {plural(fed, 'number')} that the card feeds it are constant; name the terms that "
            "it was trained on under `observations`"
        )
    return "the checkpoint does not react to its inputs" + (
        f", of which {constant} of {fed} are constant" if constant else ""
    )


def body_findings(recording: Recording) -> list[ProbeFinding]:
    """Return how the robot fared."""
    if recording.outcome is not None:
        words = {"fell": "fell over", "collided": "hit its head or trunk"}
        text = f"it {words.get(recording.outcome, recording.outcome)} at {recording.seconds:.2f} s"
        return [ProbeFinding(kind="fault", text=text)]
    tilt = float(recording.tilt.max())
    if tilt > STUMBLES:
        return [ProbeFinding(kind="fault", text=f"it leans by {tilt:.2f} rad on the way")]
    return []


def command_findings(followed: list[Followed]) -> list[ProbeFinding]:
    """Return which commands are missed; a fault where trials command it."""
    missed = [one for one in followed if one.is_missed]
    if stands_still(followed):
        is_own = all(one.motion.is_own for one in followed)
        kind = "fault" if is_own or any(one.motion.is_used for one in missed) else "note"
        text = "it stands still" if is_own else "it stands still, whatever is commanded"
        return [ProbeFinding(kind=kind, text=f"`command`: {text}")]
    findings: list[ProbeFinding] = []
    for one in missed:
        direction, commanded, reached = one.words
        text = f"`command`: {commanded} {direction}, {reached} reached ({one.ratio:z.0%})"
        text += ", and it fell" if one.fell else ""
        scales = "" if one.motion.is_own else " and the `scale` of `command`"
        text += f"; check `control.scale`{scales}"
        findings.append(ProbeFinding(kind="fault" if one.motion.is_used else "note", text=text))
    return findings


def _against(robot: RobotSpec, recording: Recording) -> list[ProbeFinding]:
    """Find joints that move away from their targets.

    No card has negative gains, so the ground pushes them; that of walking policies does it too.
    """
    wanted = recording.targets - recording.positions[:-1]
    moved = np.diff(recording.positions, axis=0)
    findings: list[ProbeFinding] = []
    for index, joint in enumerate(robot.joints):
        pull, motion = wanted[:, index], moved[:, index]
        if np.ptp(recording.targets[:, index]) < _MOVES or motion.std() < 1e-4:
            continue
        agreement = float(np.corrcoef(pull, motion)[0, 1])
        if agreement < -_OFTEN:
            text = f"{short_name(joint)}: moves against its targets (correlation {agreement:.2f})"
            findings.append(ProbeFinding(kind="note", text=text))
    return findings


def _by_joint(shares: Array, joints: Any, what: str, *, note: bool = False) -> list[ProbeFinding]:
    often = [
        f"{short_name(joint)} {share:.0%}"
        for joint, share in zip(joints, shares.tolist(), strict=True)
        if share > _OFTEN
    ]
    if not often:
        return []
    kind = "note" if note else "fault"
    return [ProbeFinding(kind=kind, text=f"{what} in much of the second: {', '.join(often)}")]


def _share_at(part: Part, recording: Recording) -> float:
    if part.limits is None:
        return 0.0
    whole = recording.observations[part.observation]
    values = whole.reshape(len(whole), -1)[:, part.indices]
    low, high = part.limits
    return float(((values <= low) | (values >= high)).mean())


_REACHED = "then reached:"  # with another card, before its figures
_CLEARLY = 0.1  # Fall of the deviation from which on another card is told.
_SLIGHTLY = 0.03  # Fall from which on a card counts for more than a likelier one.
_ENOUGH = 0.1  # Deviation below which no card is clearly better. Of right cards: 0.07 to 0.23.
_LOST = 0.9  # Deviation of a policy that stumbles, stands, or does something else.


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Another card, and what became of the commands under it."""

    hypothesis: Hypothesis
    written: Sequence[Followed]
    """What becomes of them under the card as it is written."""
    followed: Sequence[Followed]
    """The same commands, in the same order."""

    @property
    def helps(self) -> bool:
        """Whether the policy does clearly better, or no longer misses what it missed."""
        gain = deviation(self.written) - deviation(self.followed)
        no_longer = _does_all(self.followed) and not _does_all(self.written)
        return gain >= (_SLIGHTLY if no_longer else _CLEARLY)

    @property
    def mends(self) -> bool:
        """Whether it helps, and the policy then does all that one does under its own card."""
        return self.helps and _does_all(self.followed)

    @property
    def figures(self) -> str:
        """The share of each command that is reached, and was."""
        return ", ".join(
            f"{current.motion.words} {_share(current)} (was {_share(was)})"
            for current, was in zip(self.followed, self.written, strict=True)
        )


def compare(
    rig: Metered, card: Card, robot: RobotSpec, recording: Recording
) -> tuple[list[Followed], list[ProbeFinding]]:
    """Return what becomes of commands under a card, and if another card does better.

    Another card that mends everything makes the card as it is a fault where the policy stumbles,
    goes the opposite way, or does a trial better under the other card: waypoints with bends on
    level ground. All else is a note: a right card may turn at half of what it is told, and a change
    that helps there can cost success.

    Args:
        rig: of the policy; when its budget is used up, what was found until then is returned.
        card: that is looked at.
        robot: that the policy drives.
        recording: of the policy under its card. If it stumbles, commands tell what other cards
            improve, and no more; these are not tried on a policy that sees images, each of which
            would be rendered again.
    """
    tried = _tried(card, recording)
    written: list[Followed] = []
    try:
        for one in follow(rig, card, tried):
            written.append(one)  # noqa: PERF402 - what was before a cut is kept.
    except SpentError:
        return written, [*command_findings(written), _cut(rig, "fault", "every command")]
    findings = [] if recording.stumbles else command_findings(written)
    if not recording.sees_images:
        trials = None if isinstance(card.command, ConstantCommand) else _Trials(rig, card)
        others = _others(rig, card, robot, written, trials, stumbles=recording.stumbles)
        if trials is not None and not any(one.kind == "fault" for one in others):
            helps = any(_REACHED in one.text for one in others)
            findings = _excused(findings, written, trials, helps=helps)
        findings += others
    return ([] if recording.stumbles else written), findings


class _Trials:
    """Trials under the card as it is written, which runs once if at all, and under others."""

    def __init__(self, rig: Rig, card: Card) -> None:
        self._rig = rig
        self._card = card
        self._written: Walk | None = None

    @property
    def written(self) -> Walk:
        """How the trial ends under the card as it is written."""
        if self._written is None:
            self._written = _walk(self._rig, self._card)
        return self._written

    def are_better(self, card: Card) -> bool:
        """Whether the trial is completed under another card, and was not or took far longer."""
        return self.written.is_worse_than(_walk(self._rig, card))


def _walk(rig: Rig, card: Card) -> Walk:
    try:
        return rig.walk(card)
    except SpentError:
        raise
    except NwEvalError:
        return Walk(completed=False, seconds=0.0)


def _excused(
    findings: list[ProbeFinding], written: Sequence[Followed], trials: _Trials, *, helps: bool
) -> list[ProbeFinding]:
    """Return what is missed as notes where it may be the policy's own.

    Some policies turn little, or not at all: they walk ahead as commanded, and no other card helps;
    or the trial is completed. No policy does the opposite of a command under its own card.
    """
    faulty = any(one.kind == "fault" for one in findings)
    if not faulty or stands_still(written) or any(one.is_opposite or one.fell for one in written):
        return findings
    ahead = [one for one in written if one.motion.is_used and one.motion.axis == 0]
    if ahead and not helps and not any(one.is_missed or one.stumbled for one in ahead):
        return [replace(one, kind="note") for one in findings]
    try:
        if not trials.written.completed:
            return findings
    except SpentError:
        return findings
    return [replace(one, kind="note") for one in findings]


def _tried(card: Card, recording: Recording) -> list[Motion]:
    """Return what is commanded; a policy that sees no command is let go on its way."""
    commanded = motions(card)
    if recording.stumbles:
        return [] if recording.sees_images else [*own_way(card), *commanded]
    acts = bool((recording.actions != recording.actions[:1]).any())
    goes = acts and finds_its_way(card) and not recording.sees_images
    return own_way(card) if goes and not commanded else commanded


def _others(
    rig: Metered,
    card: Card,
    robot: RobotSpec,
    written: Sequence[Followed],
    trials: _Trials | None,
    *,
    stumbles: bool,
) -> list[ProbeFinding]:
    """Return the other card that helps most, or that none does."""
    is_bad = stumbles or any(one.is_missed or one.stumbled for one in written)
    if not written or not (is_bad or any(one.is_weak for one in written)):
        return []
    best: Attempt | None = None
    cut: list[ProbeFinding] = []
    try:
        for attempt in attempts(rig, card, robot, written, thorough=is_bad):
            best = attempt
    except SpentError:
        cut = [_cut(rig, "note", "every other card")]
    if best is not None and best.helps:
        is_certain = stumbles or any(one.is_opposite for one in written)
        matters = any(
            (one.is_missed or one.stumbled) and (one.motion.is_used or one.motion.is_own)
            for one in written
        )
        try:
            is_fault = best.mends and (is_certain or (matters and _better(trials, best)))
        except SpentError:
            is_fault = False
        does = ("walks" if stumbles else "follows") + ("" if is_fault else " better")
        text = f"it {does} {best.hypothesis.advice(card)}\n  {_REACHED} {best.figures}"
        return [ProbeFinding(kind="fault" if is_fault else "note", text=text), *cut]
    if cut or not is_bad:
        return cut
    nearest = "none is better than the card"
    if best is not None:
        nearest = f"the nearest, with {best.hypothesis.words}: {best.figures}"
    return [ProbeFinding(kind="note", text=f"none of the changes tried helps: {TRIED}; {nearest}")]


def _better(trials: _Trials | None, best: Attempt) -> bool:
    """Whether trials are better under another card; so where the card drives along no course."""
    return trials is None or trials.are_better(best.hypothesis.card)


def _cut(rig: Metered, kind: Literal["fault", "note"], what: str) -> ProbeFinding:
    text = f"cut off after {rig.spent:.0f} s of simulation: not {what} was tried"
    return ProbeFinding(kind=kind, text=text)


def attempts(
    rig: Rig,
    card: Card,
    robot: RobotSpec,
    written: Sequence[Followed],
    *,
    thorough: bool,
) -> Iterator[Attempt]:
    """Yield other cards, each better than those before; none if none is better than the card.

    Args:
        rig: of the policy.
        card: that is looked at.
        robot: that the policy drives.
        written: what becomes of commands under the card; at least one.
        thorough: whether everything is tried, or only other scales of the action.
    """
    order = sorted(range(len(written)), key=lambda place: _weight(written[place]))
    tried = [written[place].motion for place in order]
    limit, best = deviation(written) - _SLIGHTLY, None
    for changes in (hypotheses, double_hypotheses) if thorough else (scale_hypotheses,):
        for hypothesis in changes(card, robot):
            try:
                followed = _below(limit, rig, hypothesis.card, tried)
            except NwEvalError:
                continue  # Not even that: the card has it right in this respect.
            if followed is not None:
                limit = deviation(followed) - _SLIGHTLY
                changed = dict(zip(order, followed, strict=True))
                in_order = [changed[place] for place in range(len(written))]
                best = Attempt(hypothesis=hypothesis, written=written, followed=in_order)
                yield best
                if deviation(followed) < _ENOUGH:
                    return
        if best is not None and best.mends:
            return


def _does_all(followed: Sequence[Followed]) -> bool:
    return not any(one.is_missed or one.stumbled for one in followed)


def _share(one: Followed) -> str:
    ending = " and fell" if one.fell else " and stumbled" if one.stumbled else ""
    return f"{one.ratio:z.2f}{ending}"


def _weight(one: Followed) -> tuple[bool, bool, float]:
    """Return what comes first: what is missed, that trials command, and by most."""
    is_used = one.motion.is_used or one.motion.is_own
    return not (one.is_missed or one.stumbled), not is_used, -one.error


def _below(limit: float, rig: Rig, card: Card, tried: Sequence[Motion]) -> list[Followed] | None:
    """Return what becomes of commands if the deviation is below a limit.

    A card is given up as soon as it cannot be, and if the first of them is of no avail.
    """
    followed: list[Followed] = []
    for one in follow(rig, card, tried, level=STUMBLES):
        followed.append(one)
        hopeless = sum(past.error**2 for past in followed) >= max(limit, 0.0) ** 2 * len(tried)
        if hopeless or followed[0].error > _LOST:
            return None
    return followed
