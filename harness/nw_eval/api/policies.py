"""Policies and their cards: listed, explained, tried for a second, drafted, served."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from nw_eval.api.message import Message, write_text
from nw_eval.errors import UsageError


def list_policies() -> str:
    """Return a table of the shipped and the project's bundles, and of the example cards."""
    from nw_eval.cards.file.listing import policy_table

    return policy_table()


def show_policy(policy: str, *, checkpoint: Path | None = None, allow_code: bool = False) -> str:
    """Return what a card says: each term, each joint, whatever is not by default, the checkpoint.

    Args:
        policy: a bundle's name, folder or card.
        checkpoint: weights to use with the card.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError: there is no such card, or it has problems; `checkpoint` cannot be used.
    """
    from nw_eval.onboarding.probe.summary import card_summary
    from nw_eval.policies import find_card

    return card_summary(find_card(policy), checkpoint=checkpoint, allow_code=allow_code)


def check_policy(
    policy: str,
    *,
    checkpoint: Path | None = None,
    scene: str | None = None,
    allow_code: bool = False,
) -> Message:
    """Run a policy for some seconds and say what is odd; exit code 2 if something is wrong.

    A policy that follows a velocity command is also commanded ahead, sideways and in turns.

    Args:
        policy: a bundle's name, folder or card.
        checkpoint: weights to use with the card.
        scene: where; a flat room if None, the only place where commands are tried too.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError, SceneError: it cannot be run at all.
    """
    from nw_eval.onboarding.probe.report import FLAT, probe_policy
    from nw_eval.policies import load_bundle

    bundle = load_bundle(policy, checkpoint=checkpoint)
    told = probe_policy(bundle, scene=scene or FLAT, allow_code=allow_code)
    return Message(text=told.text, exit_code=0 if told.passed else UsageError.exit_code)


def init_policy(
    checkpoint: Path, *, robot: str, out: Path | None = None, layout: str | None = None
) -> Message:
    """Inspect a checkpoint without running it, and write a first card beside it.

    Args:
        checkpoint: any format that an adapter reads.
        robot: which robot the policy drives.
        out: the card to write; `policy.yaml` beside the checkpoint if None.
        layout: name of the published layout that it is to have; the likeliest if None.

    Raises:
        PolicyError: the file cannot be read, could run code, holds an unknown network, or does not
            fit `layout`.
        UsageError: there is a card already.
    """
    from nw_eval.cards.file.load import CARD_FILE
    from nw_eval.onboarding.drafting.draft import draft_of
    from nw_eval.onboarding.reading.beside import files_beside
    from nw_eval.rollout.confined.access import inspecting_rules
    from nw_eval.rollout.confined.isolated import call_isolated

    card = out or checkpoint.parent / CARD_FILE
    if card.exists():
        raise UsageError(f"{card} exists already", fix="move it away, or name another with --out")
    text = str(
        call_isolated(
            draft_of,
            subject=str(checkpoint),
            rules=inspecting_rules(checkpoint),
            checkpoint=str(checkpoint),
            robot=robot,
            folder=str(card.parent),
            layout=layout,
        )
    )
    if card.parent.resolve() == checkpoint.parent.resolve():
        text += files_beside(checkpoint)
    write_text(card, text)
    return Message(text=f"{text}\n{card}: {text.count('CHECK')} lines to check")


def fold_policy(checkpoint: Path, *, out: Path) -> str:
    """Write an ONNX graph and the weights in files beside it as one file, without running it.

    Args:
        checkpoint: the graph.
        out: the file to write.

    Raises:
        PolicyError: the graph or a file that it names cannot be read, or is not safe to run.
        UsageError: `out` exists already, or cannot be written.
    """
    from nw_eval.policies.onnx.fold import fold
    from nw_eval.rollout.confined.access import folding_rules
    from nw_eval.rollout.confined.isolated import call_isolated

    size = call_isolated(
        fold,
        subject=str(checkpoint),
        rules=folding_rules(checkpoint, out),
        checkpoint=str(checkpoint),
        out=str(out),
    )
    return f"{out}: {int(size) / 1e6:.2f} MB, graph and weights"


@contextmanager
def serve_policy(
    policy: str,
    *,
    checkpoint: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_code: bool = False,
    confined: bool = False,
) -> Generator[str]:
    """Serve a policy over a websocket, for `adapter: remote`, and give a line that says where.

    Args:
        policy: a bundle's name, folder or card.
        checkpoint: weights to use with the card.
        host: address to listen on; whoever reaches it can use the policy.
        port: 0 for a free one.
        allow_code: whether Python code that the card names may be imported.
        confined: raise the fence round this process, for good; for one that does nothing else.

    Raises:
        PolicyError: the policy cannot be opened.
        UsageError: the address is taken or is not this machine's.
        PrerequisiteError: websockets is not installed.
    """
    from nw_eval.confinement import child_environment

    # Before anything is imported that starts threads, which would stay outside of the fence.
    with child_environment() if confined and not allow_code else nullcontext():
        from nw_eval.policies import load_bundle
        from nw_eval.policies.remote.serve import serving
        from nw_eval.rollout.confined.access import fence_in_server
        from nw_eval.sensors import check_card

        bundle = load_bundle(policy, checkpoint=checkpoint)
        code_from = bundle.folder if allow_code else None
        specs = check_card(bundle.card, where=bundle.card_path, code_from=code_from)
        shapes = {spec.name: spec.shape for spec in specs}
        if confined and not allow_code:
            fence_in_server(bundle)
        with serving(bundle, host=host, port=port, allow_code=allow_code, shapes=shapes) as address:
            yield f"serving {bundle.name} at {address.url} (digest {bundle.digest})"
