"""`nw-eval policies`: which there are, what a card says, if it is right, a first one, a hub's."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class List:
    """List the policies that can be asked for by name."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.policies import policy_table

        print(policy_table(api.list_policies()))
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Say what a card says: every term, every joint, whatever is not by default, the checkpoint."""

    policy: tyro.conf.Positional[str]
    """A shipped bundle's name, a bundle's folder, a card, or hub:org/name."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    allow_code: bool = False
    """Let the card import Python code."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.card import card_page

        summary = api.show_policy(
            self.policy, checkpoint=self.checkpoint, allow_code=self.allow_code
        )
        print(card_page(summary))
        return 0


@dataclass(frozen=True, kw_only=True)
class Check:
    """Run a policy for some seconds: range of every term, dead inputs, NaN, wrong signs and orders.

    In the flat room, a policy that sees a velocity command is also commanded ahead, sideways and in
    turns, and other cards are tried if it stumbles or misses a command; not so in another --scene.
    Says `no fault found`, or what is wrong and what the card should say (exit code 2).
    """

    policy: tyro.conf.Positional[str]
    """A shipped bundle's name, a bundle's folder, a card, or hub:org/name."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    scene: str | None = None
    """Where; a flat room when absent."""
    allow_code: bool = False
    """Let the card import Python code."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.probe import probe_page
        from nw_eval.errors import UsageError

        report = api.check_policy(
            self.policy,
            checkpoint=self.checkpoint,
            scene=self.scene,
            allow_code=self.allow_code,
        )
        print(probe_page(report))
        return 0 if report.passed else UsageError.exit_code


@dataclass(frozen=True, kw_only=True)
class Init:
    """Inspect a checkpoint, without running it, and write a first card beside it."""

    checkpoint: tyro.conf.Positional[Path]
    """An ONNX, TorchScript, torch.export, safetensors or state-dict file."""
    robot: str
    """The robot that the policy drives: go1 or go2."""
    out: Path | None = None
    """The card to write; `policy.yaml` beside the checkpoint when absent."""
    layout: str | None = None
    """The published layout of what the policy sees, such as isaac-lab; the likeliest when absent.
    The card names those that fit."""

    def __call__(self) -> int:
        from nw_eval import api

        draft = api.init_policy(self.checkpoint, robot=self.robot, out=self.out, layout=self.layout)
        print(f"{draft.text}\n{draft.file}: {draft.to_check} lines to check")
        return 0


@dataclass(frozen=True, kw_only=True)
class Fold:
    """Write an ONNX graph whose weights lie in a second file as one file, without running it."""

    checkpoint: tyro.conf.Positional[Path]
    """The ONNX file; what it names lies beside it."""
    out: Path
    """The file to write."""

    def __call__(self) -> int:
        from nw_eval import api

        folded = api.fold_policy(self.checkpoint, out=self.out)
        print(f"{folded.file}: {folded.bytes / 1e6:.2f} MB, graph and weights")
        return 0


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Serve a policy over a websocket, for `adapter: remote`, until SIGINT or SIGTERM."""

    policy: tyro.conf.Positional[str]
    """A shipped bundle's name, a bundle's folder, a card, or hub:org/name."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    host: str = "127.0.0.1"
    """Address to listen on; whoever reaches it can use the policy."""
    port: int = 8765
    """Port to listen on; 0 chooses a free one."""
    allow_code: bool = False
    """Let the card import Python code."""

    def __call__(self) -> int:
        from nw_eval import api

        stop = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            # Said outright: a shell starts its background jobs with SIGINT ignored.
            signal.signal(number, lambda *_: stop.set())
        with api.serve_policy(
            self.policy,
            checkpoint=self.checkpoint,
            host=self.host,
            port=self.port,
            allow_code=self.allow_code,
            confined=True,
        ) as served:
            print(f"serving {served.name} at {served.url} (digest {served.digest})", flush=True)
            stop.wait()
        return 0


@dataclass(frozen=True, kw_only=True)
class FetchPolicy:
    """Fetch a policy as its hub has it now; runs use it from then on, without a network.

    Nothing of it is run, and the token that it needs is not needed again. A download that breaks
    goes on where it broke when the command is given again. HF_TOKEN or `hf auth login` says who you
    are, HF_ENDPOINT which hub. Needs the extra `hub`.
    """

    policy: tyro.conf.Positional[str]
    """hub:org/name, or hub:org/name@revision."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.elsewhere import fetched_lines

        print(fetched_lines(api.fetch_policy(self.policy)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Policies:
    """List policies, show and check their cards, draft, fold, serve or fetch one."""

    action: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Init, tyro.conf.subcommand("init")]
        | Annotated[Fold, tyro.conf.subcommand("fold")]
        | Annotated[Serve, tyro.conf.subcommand("serve")]
        | Annotated[FetchPolicy, tyro.conf.subcommand("fetch")]
    )

    def __call__(self) -> int:
        return self.action()
