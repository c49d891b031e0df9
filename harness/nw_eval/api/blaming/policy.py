"""Which policy takes over: a bank's, or one that is named itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.policies import Bundle
    from nw_eval.results.provenance import RunInfo


def baseline_bundle(
    baseline: str, info: RunInfo, *, policy: str | None, checkpoint: Path | None
) -> Bundle:
    """Return the policy that a baseline's name means: that of a bank, or else one of that name.

    Args:
        baseline: see above; a bank of the run's own suite goes before a policy.
        info: the run's.
        policy: where the bank's policy lies.
        checkpoint: weights of it.

    Raises:
        UsageError: there is neither; or no bank, and a policy is named as well.
        StoreError: the bank is damaged.
        IncomparableError: the bank's policy is not the one that is there.
        PolicyError: the policy cannot be loaded.
    """
    from nw_eval.errors import IncomparableError, PolicyError, UsageError
    from nw_eval.policies import find_card, load_bundle
    from nw_eval.results.bank_file import find_bank, read_bank

    try:
        bank = read_bank(find_bank(baseline, suite=str(info.suite.get("name", ""))))
    except UsageError as error:
        no_bank = error
    else:
        own = bank.manifest.policy
        bundle = load_bundle(find_card(policy or own.card or own.name), checkpoint=checkpoint)
        if (bundle.checkpoint_digest, bundle.digest) != (own.checkpoint_digest, own.card_digest):
            raise IncomparableError(
                f"baseline {bank.manifest.name} was saved with {own.name} "
                f"({own.checkpoint_digest[:8]}), and {bundle.where} is another one "
                f"({bundle.checkpoint_digest[:8]})",
                fix="say where it lies with --policy and --checkpoint, or name the policy itself "
                "with --baseline",
            )
        return bundle
    if policy is not None:
        raise no_bank
    try:
        return load_bundle(find_card(baseline), checkpoint=checkpoint)
    except PolicyError as error:
        raise UsageError(f"{no_bank.message}, and no policy: {error.message}") from None
