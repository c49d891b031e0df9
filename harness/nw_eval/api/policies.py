"""Policies and their cards: listed, explained, tried for a second, drafted, served."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import CrashError, PolicyError, UsageError
from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_policies.cards.load import ListedPolicy
    from nw_sim.probe.report import ProbeReport
    from nw_sim.probe.summary import CardSummary


@dataclass(frozen=True, kw_only=True)
class CardDraft:
    """A first card for a checkpoint, as it was written."""

    file: Path
    text: str
    to_check: int
    """How many lines its author has to look at, marked CHECK."""


@dataclass(frozen=True, kw_only=True)
class FoldedGraph:
    """An ONNX graph and its weights in one file, as it was written."""

    file: Path
    bytes: int


@dataclass(frozen=True, kw_only=True)
class ServedPolicy:
    """A policy that is being served."""

    name: str
    digest: str
    """Of the card, the weights and the code beside them."""
    url: str
    """What a card's `options.url` must be."""


def list_policies() -> tuple[ListedPolicy, ...]:
    """Return the shipped bundles, those of the project, and the example cards, by name."""
    from nw_policies.cards.load import list_cards

    return list_cards()


def show_policy(
    policy: str,
    *,
    robot: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    allow_code: bool = False,
) -> CardSummary:
    """Return what a card says: each term, each joint, whatever is not by default, its files.

    Args:
        policy: a shipped policy's name, a policy folder, a card, or `hub:org/name`.
        robot: the robot's folder (default: found by the card's robot name).
        checkpoint: weights to use with the card.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        RobotError: the folder cannot be used, or is of another robot.
        PolicyError: there is no such card, or it has problems; `checkpoint` cannot be used.
    """
    from nw_policies import find_card
    from nw_sim.probe.summary import card_summary

    checkpoint = as_path(checkpoint)
    card = find_card(policy)
    _know(robot, card)
    return card_summary(card, checkpoint=checkpoint, allow_code=allow_code)


def _know(robot: str | None, card: Path) -> None:
    """Let the robot that a card names be the one of a folder.

    Raises:
        UsageError: there is no such robot.
        RobotError: it cannot be used, or the card names another one.
    """
    if robot is None:
        return
    from nw_base.errors import RobotError
    from nw_base.files.yaml_file import YamlProblems, read_yaml
    from nw_scenes.robots import find_robot

    name = find_robot(robot).spec.name
    try:
        meant = read_yaml(card).data.get("robot")
    except YamlProblems:
        return  # Whoever loads the card says what is wrong with it.
    if isinstance(meant, str) and name != meant:
        raise RobotError(
            f"--robot {robot} is the robot {name!r}, and {card} is a card of {meant!r}",
            fix=f"write `robot: {name}` into the card, or name the folder of {meant!r}",
        )


def check_policy(
    policy: str,
    *,
    robot: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    scene: str | None = None,
    allow_code: bool = False,
) -> ProbeReport:
    """Run a policy for some seconds, in a process of its own, and return what is odd.

    A policy that follows a velocity command is also commanded ahead, sideways and in turns.

    Args:
        policy: a shipped policy's name, a policy folder, a card, or `hub:org/name`.
        robot: the robot's folder (default: found by the card's robot name).
        checkpoint: weights to use with the card.
        scene: the scene (default: a flat room, the only one in which commands are tested).
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError: it cannot be run at all.
        RobotError: the robot's folder cannot be used, or is of another robot.
        SceneError: there is no such scene.
    """
    from nw_policies import find_card, load_bundle
    from nw_sim.catalogue import brought, parse_reference
    from nw_sim.probe.report import FLAT, probe_policy

    checkpoint = as_path(checkpoint)
    if robot is not None:
        _know(robot, find_card(policy))
    bundle = load_bundle(policy, checkpoint=checkpoint)
    place = scene or FLAT
    plain, _ = parse_reference(place)
    # The process that tries the policy has no network.
    place = f"{place.removesuffix(plain)}{brought(plain)}"
    return probe_policy(bundle, scene=place, allow_code=allow_code)


def init_policy(
    checkpoint: str | PathLike[str],
    *,
    robot: str,
    out: str | PathLike[str] | None = None,
    layout: str | None = None,
) -> CardDraft:
    """Inspect a checkpoint and what lies beside it, without running it, and write a first card.

    Only a TorchScript file that does not say the size of its one input runs, once on zeros for each
    size that it may have, in a confined process.

    Args:
        checkpoint: an ONNX, TorchScript, torch.export, safetensors or state-dict file, or a
            training checkpoint: rsl_rl, skrl, rl_games, CleanRL, Stable-Baselines3, brax or flax.
            For a folder, the newest step is used.
        robot: the robot that the policy controls: a name such as go1, or a folder.
        out: the card to write (default: `policy.yaml` beside the checkpoint or in its folder).
        layout: the published observation layout, such as isaac-lab (default: the most likely one).
            The card lists the layouts that fit.

    Raises:
        PolicyError: the file cannot be read, could run code, holds an unknown network, does not fit
            `layout`, or drives another robot; the folder has no checkpoint.
        UsageError: there is a card already, or no such robot.
        RobotError, FetchError, PrerequisiteError: the robot cannot be used, or fetched.
        StoreError: the card cannot be written.
    """
    from nw_base.files.cache import atomic_path, followed
    from nw_base.files.inside import what_is
    from nw_policies.cards.load import CARD_FILE
    from nw_policies.drafting.beside import files_beside_checkpoint, find_checkpoint
    from nw_policies.drafting.draft import draft_of
    from nw_policies.drafting.feeders import files_beside, may_feed
    from nw_policies.drafting.notation import lines_to_check, plain
    from nw_policies.drafting.tracking import motions_beside
    from nw_policies.drafting.trained import statistics_beside
    from nw_scenes.robots import find_robot
    from nw_sim.rollout.confined.access import inspecting_rules
    from nw_sim.rollout.confined.isolated import call_isolated

    checkpoint = as_path(checkpoint)
    out = as_path(out)
    entry = find_robot(robot)
    others: tuple[str, ...] = ()
    folder = checkpoint.parent
    if what_is(checkpoint) == "folder":
        folder = checkpoint
        checkpoint, others = find_checkpoint(checkpoint)
    card = out or folder / CARD_FILE
    if what_is(followed(card)) == "file":
        raise UsageError(f"{card} exists already", fix="move it away, or name another with --out")
    statistics = statistics_beside(checkpoint)
    is_beside = card.parent.resolve() == checkpoint.parent.resolve()
    # A card names files of its own folder alone.
    feeders = [path for path in may_feed(checkpoint) if path.suffix == ".onnx"] if is_beside else []
    draft = partial(
        call_isolated,
        draft_of,
        subject=str(checkpoint),
        rules=inspecting_rules(
            checkpoint,
            robot=entry.folder,
            also=[*feeders, *([] if statistics is None else [statistics])],
        ),
        checkpoint=str(checkpoint),
        robot=entry.reference,
        robot_folder=None if entry.folder is None else str(entry.folder),
        folder=str(card.parent),
        layout=layout,
        beside=files_beside_checkpoint(checkpoint, entry.spec.name),
        statistics=None if statistics is None else str(statistics),
        motions=motions_beside(checkpoint, card.parent),
        feeders=list(map(str, feeders)),
    )
    drafted = draft()
    if widths := drafted["widths"]:
        taken = _taken(checkpoint, widths)
        drafted = draft(taken=taken) if taken not in {0, widths[0]} else drafted
    text = str(drafted["text"])
    if others:
        shown = ", ".join(others[:6]) + f" and {len(others) - 6} more" * (len(others) > 6)
        newest = f"{plain(checkpoint.name)} is the newest checkpoint here, beside {plain(shown)}."
        text = f"# {newest}\n{text}"
    elif is_beside and "\nnetworks:" not in text:
        text += files_beside(checkpoint)
    with atomic_path(followed(card)) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return CardDraft(file=card, text=text, to_check=lines_to_check(text))


def _taken(checkpoint: Path, widths: Sequence[int]) -> int:
    """Return which of some widths a TorchScript file takes, asked in a process; 0 if none."""
    from nw_policies.drafting.draft import width_taken
    from nw_sim.rollout.confined.access import inspecting_rules
    from nw_sim.rollout.confined.isolated import call_isolated

    try:
        taken = call_isolated(
            width_taken,
            subject=str(checkpoint),
            rules=inspecting_rules(checkpoint),
            checkpoint=str(checkpoint),
            widths=list(widths),
        )
    except (PolicyError, CrashError):
        return 0  # A draft does not need it, and `check` says what is wrong with the file.
    return taken if taken in widths else 0


def fold_policy(checkpoint: str | PathLike[str], *, out: str | PathLike[str]) -> FoldedGraph:
    """Write a checkpoint of several files as one file, without running it.

    Args:
        checkpoint: an ONNX file with its weights in a second file, or the folder of an Orbax step,
            which becomes a safetensors file.
        out: the file to write.

    Raises:
        PolicyError: it cannot be read, or is not safe to run.
        PrerequisiteError: it is of Orbax, and the extra `orbax` is not installed.
        UsageError: `out` exists already, or is not a file's path.
        StoreError: `out` cannot be written.
    """
    from nw_base.files.cache import followed
    from nw_base.files.inside import what_is
    from nw_policies.folding import fold, fold_orbax
    from nw_sim.rollout.confined.access import folding_rules
    from nw_sim.rollout.confined.isolated import call_isolated
    from nw_sim.rollout.replaying.apart import fetch, scratch_folder

    checkpoint = as_path(checkpoint)
    out = as_path(out)
    if what_is(followed(out)) == "file":
        raise UsageError(f"{out} exists already", fix="move it away, or name another with --out")
    with scratch_folder() as folder:
        folded = folder / "folded.onnx"
        size = call_isolated(
            fold_orbax if what_is(checkpoint) == "folder" else fold,
            subject=str(checkpoint),
            rules=folding_rules(checkpoint, folder),
            checkpoint=str(checkpoint),
            out=str(folded),
        )
        fetch(folded, out)
    return FoldedGraph(file=out, bytes=int(size))


@contextmanager
def serve_policy(
    policy: str,
    *,
    checkpoint: str | PathLike[str] | None = None,
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_code: bool = False,
    confined: bool = False,
) -> Generator[ServedPolicy]:
    """Serve a policy over a websocket, for `adapter: remote`, while the context lasts.

    Args:
        policy: a shipped policy's name, a policy folder, a card, or `hub:org/name`.
        checkpoint: weights to use with the card.
        host: address to listen on; anyone who can reach it can use the policy.
        port: port to listen on; 0 chooses a free one.
        allow_code: whether Python code that the card names may be imported.
        confined: raise the fence round this process, for good; for one that does nothing else.

    Raises:
        PolicyError: the policy cannot be opened.
        UsageError: the address is taken or is not this machine's.
        PrerequisiteError: websockets is not installed.
    """
    from nw_base.confinement import child_environment

    # Before anything is imported that starts threads, which would stay outside of the fence.
    checkpoint = as_path(checkpoint)
    with child_environment() if confined and not allow_code else nullcontext():
        from nw_policies import load_bundle
        from nw_policies.serve import serving
        from nw_sim.rollout.confined.access import fence_in_server
        from nw_sim.rollout.confined.vetting import vet_bundle
        from nw_sim.sensors import check_card

        bundle = load_bundle(policy, checkpoint=checkpoint)
        if bundle.files and not allow_code:
            vet_bundle(bundle, bundle.card.robot)  # With the limits of a run, which a server lacks.
        code_from = bundle.folder if allow_code else None
        specs = check_card(bundle.card, where=bundle.card_path, code_from=code_from)
        shapes = {spec.name: spec.shape for spec in specs}
        if confined and not allow_code:
            fence_in_server(bundle, port=port)
        with serving(bundle, host=host, port=port, allow_code=allow_code, shapes=shapes) as address:
            yield ServedPolicy(name=bundle.name, digest=bundle.digest, url=address.url)
