"""Opens policies: one class for each kind of checkpoint; `open_policy` picks it by the card.

Policies that are Python classes are here: `adapter: python:package.module:Class`, behind
--allow-code. The class is called with the bundle and must have `act(observation) -> 12 numbers`.
Whatever else of `Policy` it has is used: `reset(seed)`, `state()` with `restore(state)`, `close()`,
`inputs`. A class without `state` promises that its next action depends on the next observation
alone.

All Python files below the card's folder count for the identity of the policy; installed code does
not. Where the card names a file as `checkpoint`, its digest is verified, and counts as well.

A caller in this process may hand in the object itself, or a function in place of its `act`
(`nw_policies.instance_bundle`). It outlives its trials, so it is never closed.
"""

from __future__ import annotations

import importlib
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any, Literal, assert_never, cast

import numpy as np

from nw_base.errors import (
    CodeError,
    NwEvalError,
    PolicyError,
    PrerequisiteError,
    TrialError,
    not_installed,
)
from nw_base.files.importable import importable
from nw_policies.asked import ApartPolicy, code_refused, files_over
from nw_policies.bundle import Bundle, read_options
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.joint_control import Action
from nw_policies.cards.networks import is_built_in
from nw_policies.chunks import ActOptions, ChunkPolicy
from nw_policies.drawing import DrawingPolicy
from nw_policies.line import PolicyLine, current_line
from nw_policies.planned import (
    OpenPolicy,
    PlannedNetwork,
    PlannedPolicy,
    files_known,
    keep_files,
    leaves,
    operator_of,
)
from nw_policies.planning import InProcess
from nw_policies.policy import ActingNetwork, Observation, Policy, raised
from nw_policies.policy_process import CodePolicy, FaultError

PROGRAMS = frozenset({"torchscript", "torch-export"})
"""Adapters whose files are programs: torch runs whatever they say."""


def open_policy(bundle: Bundle, *, allow_code: bool = False) -> Policy:
    """Load a bundle's checkpoint, and its networks: in the policy's process, where there is one.

    That process reads files of networks and plans them; what they compute is data then, which is
    checked and runs here (`planned`). With `runtime: native` it runs them itself, as where nw-eval
    lacks an operator and the card leaves the choice.

    Args:
        bundle: from `load_bundle`.
        allow_code: whether `python:` adapters may import the user's code.

    Raises:
        PolicyError: a file is not what the card's adapter reads, or its inputs and outputs do not
            fit the card.
        PrerequisiteError: the package that reads its files is not installed.
    """
    line, card = current_line(), bundle.card
    if card.adapter == "zero":
        return ZeroPolicy(joints=bundle.joints)
    if not card.is_planned:
        return _open_native(bundle, line, allow_code=allow_code)
    if card.runtime is None and (operator := operator_of(bundle)):
        return _open_native(bundle.by_its_own_runtime(operator), line, allow_code=allow_code)
    if card.adapters <= {"onnx"}:  # Their files say the sizes of their inputs.
        try:
            files = files_known(bundle)
            if files is None and line is not None:
                files = files_over(line, bundle)
                keep_files(bundle, files)
            return _open_here(bundle.with_changes(programs=files or {}), allow_code=allow_code)
        except PolicyError as error:
            if not leaves(bundle, error):
                raise
        left = bundle.by_its_own_runtime(operator_of(bundle))
        return _open_native(left, line, allow_code=allow_code)

    def start() -> OpenPolicy:
        native = bundle.with_changes(card=card.model_copy(update={"runtime": "native"}))
        policy = _open_native(native, line, allow_code=allow_code)
        return policy if isinstance(policy, ApartPolicy) else cast("OpenPolicy", InProcess(policy))

    return PlannedPolicy(bundle, start, partial(_open_here, allow_code=allow_code))


def _open_native(bundle: Bundle, line: PolicyLine | None, *, allow_code: bool) -> Policy:
    """Open a bundle to be run by the runtimes of its files.

    Raises:
        PrerequisiteError: they are not installed.
    """
    if line is not None:
        return ApartPolicy(bundle, line, joints=bundle.joints, allow_code=allow_code)
    policy = _open_here(bundle, allow_code=allow_code)
    draws = bundle.card.adapters & PROGRAMS or bundle.card.adapter.startswith("python:")
    return DrawingPolicy(policy, name=bundle.name) if draws and bundle.instance is None else policy


def _open_here(bundle: Bundle, *, allow_code: bool) -> Policy:
    try:
        policy = _open_checkpoint(bundle, allow_code=allow_code)
        if bundle.card.networks:
            from nw_policies.fed_policy import FedPolicy

            policy = FedPolicy(bundle, policy, allow_code=allow_code)
    except ModuleNotFoundError as error:
        absent = not_installed(error)
        if absent is None:
            raise
        why = f"nw-eval does not run {bundle.operator}, and " if bundle.operator else ""
        raise PrerequisiteError(
            f"{bundle.where}: `{bundle.card.adapter}`: {why}{absent.message}", fix=absent.fix
        ) from None
    return policy


def _open_checkpoint(bundle: Bundle, *, allow_code: bool) -> Policy:
    """Open a bundle's own checkpoint, without the networks that feed it."""
    joints = bundle.joints
    adapter = bundle.card.adapter
    if not is_built_in(adapter):
        return PythonPolicy(bundle, joints=joints, allow_code=allow_code)
    if bundle.card.is_planned and adapter != "onnx":
        return _open_planned(bundle, joints=joints)
    match adapter:
        case "onnx":
            from nw_policies.onnx import OnnxPolicy

            return OnnxPolicy(bundle, joints=joints)
        case "torchscript":
            from nw_policies.torchscript import TorchScriptPolicy

            return TorchScriptPolicy(bundle, joints=joints, allow_code=allow_code)
        case "torch-export":
            from nw_policies.torch_network import TorchExportPolicy

            return TorchExportPolicy(bundle, joints=joints, allow_code=allow_code)
        case "mlp" | "lucidsim" | "extreme-parkour" | "act":
            return _open_weights(adapter, bundle, joints=joints)
        case "remote":
            from nw_policies.remote import RemotePolicy

            return RemotePolicy(bundle, joints=joints)
        case "zero":
            return ZeroPolicy(joints=joints)
        case _:
            assert_never(adapter)


def _open_planned(bundle: Bundle, *, joints: int) -> Policy:
    """Open what a bundle's own checkpoint was planned into."""
    network = PlannedNetwork(bundle, [bundle.card.output])
    if bundle.card.adapter != "act":
        return ActingNetwork(network, joints=joints, policy=bundle.name)
    options = read_options(bundle, ActOptions)
    return ChunkPolicy(network, options, joints=joints, policy=bundle.name, is_exact=True)


def _open_weights(
    adapter: Literal["mlp", "lucidsim", "extreme-parkour", "act"], bundle: Bundle, *, joints: int
) -> Policy:
    """Open a file that holds the weights of a network of ours, and no network."""
    match adapter:
        case "mlp":
            from nw_policies.mlp import MlpPolicy

            return MlpPolicy(bundle, joints=joints)
        case "lucidsim":
            from nw_policies.published import LucidSimPolicy

            return LucidSimPolicy(bundle, joints=joints)
        case "extreme-parkour":
            from nw_policies.published import open_extreme_parkour

            return open_extreme_parkour(bundle, joints=joints)
        case "act":
            from nw_policies.published import open_act

            return open_act(bundle, joints=joints)


class ZeroPolicy:
    """Answers every observation with zeros: the robot holds its default pose."""

    inputs: tuple[InputSpec, ...] = ()

    def __init__(self, *, joints: int) -> None:
        self._joints = joints

    def reset(self, seed: int) -> None:
        """Begin a trial; there is nothing to forget and nothing random."""

    def act(self, observation: Observation) -> Action:  # noqa: ARG002 - that is the point.
        """Return zeros."""
        return np.zeros(self._joints)

    def state(self) -> bytes:
        """Return an empty state."""
        return b""

    def restore(self, state: bytes) -> None:
        """Go back to a state; all of them are the same."""

    def close(self) -> None:
        """Do nothing, as always."""


class PythonPolicy:
    """An object of the user's, with its actions checked.

    Args:
        bundle: its card, and the object itself if it is there.
        joints: how many numbers an action has.
        allow_code: whether its module may be imported.

    Raises:
        PolicyError: code is not allowed.
        CodeError: the class cannot be imported or made, or the object is not a policy.
    """

    def __init__(self, bundle: Bundle, *, joints: int, allow_code: bool) -> None:
        self._name = bundle.name
        self._is_ours = bundle.instance is None
        user_object: Any = (
            _make(bundle, allow_code=allow_code) if self._is_ours else bundle.instance
        )
        self.inputs: tuple[InputSpec, ...] = getattr(user_object, "inputs", ())
        if self._is_ours and not callable(getattr(user_object, "act", None)):
            user_object = SimpleNamespace(act=None)  # A function is not a class's object.
        with _faults():
            self._policy: CodePolicy | None = CodePolicy(
                user_object,
                name=bundle.name,
                adapter=bundle.card.adapter,
                where=bundle.where,
                joints=joints,
            )

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        if self._policy is not None:
            with _faults():
                self._policy.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Ask the object, which gets copies: it may write into them.

        Raises:
            TrialError: it raised, or its action is not twelve finite numbers.
        """
        if self._policy is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        with _faults():
            return self._policy.act(observation)
        raise AssertionError("no exception vanishes")

    def state(self) -> bytes:
        """Return the object's memory."""
        if self._policy is None:
            return b""
        with _faults():
            return self._policy.state()
        raise AssertionError("no exception vanishes")

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        if self._policy is not None:
            with _faults():
                self._policy.restore(state)

    def close(self) -> None:
        """Close the object."""
        policy, self._policy = self._policy, None
        if policy is not None and self._is_ours:
            with _faults():
                policy.close()


@contextmanager
def _faults() -> Generator[None]:
    """Turn what is wrong with the object into an error of this program."""
    try:
        yield
    except FaultError as fault:
        if isinstance(fault.__cause__, TrialError):
            raise fault.__cause__ from None  # It raised what adapters raise, on purpose.
        raise raised(fault) from fault.__cause__


def _make(bundle: Bundle, *, allow_code: bool) -> Any:
    if not allow_code:
        raise code_refused(bundle)
    if bundle.card.python is not None:
        raise PolicyError(
            f"{bundle.where}: `python: {bundle.card.python}` runs the code in a process of its own",
            fix="drop --in-process, or run it there as a server and use `remote`",
        )
    module, _, name = bundle.card.adapter.removeprefix("python:").partition(":")
    try:
        with importable(bundle.folder):
            cls = getattr(importlib.import_module(module), name)
        return cls(bundle)
    except NwEvalError:
        raise
    except Exception as error:  # noqa: BLE001 - the user's code may raise anything.
        raise CodeError(
            f"{bundle.where}: {bundle.card.adapter} cannot be opened: "
            f"{type(error).__name__}: {error}",
            fix=f"the module must lie in {bundle.folder} or be installed, and the class take the "
            "bundle",
        ) from None
