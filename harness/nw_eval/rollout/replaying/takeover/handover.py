"""Who drove a recorded trial, and what its log says if one policy took over from another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import TypeAdapter, ValidationError

from nw_eval.cards.load import CARD_FILE, parse_card
from nw_eval.clean import clean
from nw_eval.errors import PolicyError, StoreError, UsageError
from nw_eval.policies.bundle import NOTHING
from nw_eval.rollout.record import attachments

if TYPE_CHECKING:
    from nw_eval.cards import Card
    from nw_eval.policies import Bundle
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.replaying.logged import LoggedTrial

HANDOVER = "takeover.json"
"""The attachment that says so."""
_SUITE = "suite.yaml"


@dataclass(frozen=True, kw_only=True)
class Handover:
    """One policy's place taken by another, in the middle of a trial."""

    step: int
    """The control step that is the second one's first."""
    policy: str
    """Which the first one was, as `driver` says it."""
    card: str
    """The text of the first one's card."""


def driver(job: TrialJob) -> str:
    """Return what the policy of a job is called among others: its name, and which weights."""
    name, digest = job.policy_name or job.policy, job.checkpoint_digest
    return name if digest in {"", NOTHING} else f"{name} ({digest[:8]})"


def handover_of(logged: LoggedTrial) -> Handover | None:
    """Return when the trial of a log was taken over, and from whom; None if it was not.

    Raises:
        StoreError: the log is damaged.
    """
    text = logged.log.attachments().get(HANDOVER)
    if text is None:
        return None
    try:
        return TypeAdapter(Handover).validate_json(text)
    except ValidationError as error:
        reason = clean(error.errors()[0]["msg"], at_most=200)
        raise StoreError(
            f"{logged.path}: its attachment {HANDOVER} is damaged: {reason}",
            fix="make the log again",
        ) from None


def new_handover(recorded: LoggedTrial, step: int) -> Handover:
    """Return a handover from the policy that a recorded trial began with.

    Raises:
        StoreError: the log is damaged.
        UsageError: the trial was taken over before that step already: its log leads no further
            with one card.
    """
    earlier = handover_of(recorded)
    if earlier is None:
        text = recorded.log.attachments().get(CARD_FILE, b"").decode(errors="replace")
        return Handover(step=step, policy=driver(recorded.job), card=text)
    if step > earlier.step:
        raise UsageError(
            f"{recorded.path} was taken over in control step {earlier.step} already",
            fix="give an earlier --from, or the log of the trial before",
        )
    return Handover(step=step, policy=earlier.policy, card=earlier.card)


def first_card(recorded: LoggedTrial) -> Card:
    """Return the card of the policy that a recorded trial began with, as its log has it.

    Raises:
        StoreError: the log holds none that can be read.
    """
    try:
        return parse_card(new_handover(recorded, 0).card, file=CARD_FILE)
    except PolicyError as error:
        raise StoreError(
            f"{recorded.path} holds no card of the policy that made it: {clean(error.message)}",
            fix="run the trial again with `nw-eval run`, whose logs do",
        ) from None


def carried(
    recorded: LoggedTrial, bundle: Bundle, handover: Handover
) -> tuple[tuple[str, str], ...]:
    """Return what the log of a trial carries along that a bundle takes over.

    Raises:
        StoreError: the recorded trial's log is damaged.
    """
    suite = recorded.log.attachments().get(_SUITE, b"").decode(errors="replace")
    own = HANDOVER, TypeAdapter(Handover).dump_json(handover).decode()
    return (*attachments(bundle.card_text, suite), own)
