"""Main loop of a policy's process: it opens policies and answers requests."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from nw_base import errors
from nw_base.clean import message_of
from nw_base.confinement import LEFT, Rules, confine, processor_time
from nw_base.errors import NwEvalError
from nw_base.memory import pack
from nw_policies.planned import listed, operator_of, packed
from nw_policies.policy_process import MessageLine, Server

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from nw_policies.bundle import Bundle
    from nw_policies.cards.feeding import InputSpec
    from nw_policies.policy import Policy


def serve_policies(
    rules: Rules,
    questions: Connection,
    answers: Connection,
    memory: Connection,
    output: Connection | None = None,
) -> NoReturn:
    """Confine this process, and serve policies: the main function of a policy's process.

    Args:
        rules: permissions of the process.
        questions: requests to the process.
        answers: its answers.
        memory: for observations.
        output: file for the text that it prints; None discards it.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    confine(rules, output=None if output is None else output.fileno())
    if output is not None:
        output.close()
    line = MessageLine(questions.fileno(), answers.fileno())
    others = {"held": _held, "plan": _plan, "try": _try}
    with suppress(OSError, ValueError):  # The answer has no reader, or the request makes no sense.
        Server(line, memory.fileno(), opened=_opened, others=others, describe=_described).serve()
    os._exit(LEFT)


def _opened(words: Mapping[str, Any]) -> tuple[Policy, dict[str, Any]]:
    from nw_policies.opening import open_policy

    bundle, allow_code = _loaded(words["bundle"])
    policy = open_policy(bundle, allow_code=allow_code)
    networks: dict[str, tuple[InputSpec, ...]] = getattr(policy, "network_inputs", {})
    answer = {
        "inputs": listed(policy.inputs),
        "networks": {name: listed(specs) for name, specs in networks.items()},
        "remembers": getattr(policy, "remembers", True),
        "digest": getattr(getattr(policy, "served", None), "digest", ""),
    }
    return policy, answer


def _loaded(data: bytes) -> Any:
    """Return what the caller has sent, whom this process trusts, and not the other way round."""
    loads: Callable[[bytes], Any] = vars(ForkingPickler)["loads"]
    return loads(data)


def _held(policy: Any, _: Mapping[str, Any]) -> dict[str, Any]:
    return {"arrays": pack(policy.held)}


def _plan(policy: Any, words: Mapping[str, Any]) -> dict[str, Any]:
    if policy is not None:
        from nw_policies.planning import plan_policy

        shown = {name: np.zeros(shape, dtype) for name, dtype, shape, _ in words["shown"]}
        return {"files": packed(plan_policy(policy, shown))}
    from nw_policies.onnx import planned_file

    bundle: Bundle = _loaded(words["bundle"])
    alone = {"": bundle} | {name: bundle.of_network(name) for name in bundle.networks}
    return {"files": packed({name: planned_file(each) for name, each in alone.items()})}


def _try(_: Any, words: Mapping[str, Any]) -> dict[str, Any]:
    from nw_policies.trying import try_on_zeros

    arguments, seconds = _loaded(words["arguments"])
    if seconds is None:
        try_on_zeros(**arguments)
    else:
        with processor_time(seconds):
            try_on_zeros(**arguments)
    return {"operator": operator_of(arguments["bundle"])}


def _described(error: BaseException) -> dict[str, Any]:
    """Return an exception in words."""
    error = errors.not_installed(error) or error
    kind = type(error).__name__
    if isinstance(error, NwEvalError):
        return {"kind": kind, "lines": error.message.split("\n"), "fix": error.fix}
    return {"kind": kind, "text": message_of(error)}
