"""Networks that nw-eval runs: planned where their files are read, and run anywhere.

ONNX files say the sizes of their inputs and are planned when they are opened. Others are opened by
their own adapter first, in the policy's process; at the first action, when the sizes of all
observations are known, torch runs them once there, and what it computes is recorded and planned.
What comes back is data (`PlannedFile`), which is checked and runs in the trial's own process.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PolicyError, TrialError
from nw_base.memory import Arrays, pack, unpack
from nw_policies.bundle import Bundle, PlannedFile, senses_by_code
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.joint_control import Action
from nw_policies.executor import NEXT, Program
from nw_policies.policy import (
    InputAssembler,
    Observation,
    Policy,
    Wanted,
    unfitting,
    unpacked,
)

_PARTS = 16
_EVERY = 1000


_RUNTIMES = {"onnx": "ONNX Runtime", "lucidsim": "ONNX Runtime"}
"""What runs the networks of adapters that torch does not run."""


def depends_on(bundle: Bundle) -> str:
    """Return what makes a policy's results depend on the processor; empty if nothing does."""
    card = bundle.card
    if card.adapter.startswith("python:") or senses_by_code(card):
        return "Python code"
    if card.adapter == "zero" or card.is_planned:
        return ""
    if bundle.operator:
        return bundle.operator
    if card.adapter == "remote":
        return "its server"
    return " and ".join(sorted({_RUNTIMES.get(adapter, "torch") for adapter in card.adapters}))


def packed(files: Mapping[str, PlannedFile]) -> bytes:
    """Return planned files as bytes, for `read_planned`."""
    arrays: Arrays = {}
    told: dict[str, Any] = {}
    for number, (name, file) in enumerate(files.items()):
        for index, (_, program) in enumerate(file.parts):
            arrays[f"{number} program {index}"] = np.frombuffer(program.packed(), np.uint8)
        arrays |= {f"{number} first {key}": array for key, array in file.first.items()}
        told[name] = {
            "every": [every for every, _ in file.parts],
            "first": list(file.first),
            "inputs": listed(file.inputs),
        }
    arrays["told"] = np.frombuffer(json.dumps(told).encode(), np.uint8)
    return pack(arrays)


def read_planned(data: bytes) -> dict[str, PlannedFile]:
    """Return planned files from bytes, whoever wrote them, with their programs checked.

    Raises:
        ValueError: they are none.
    """
    try:
        return _read(unpack(data))
    except (KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"no plans: {error!r}") from None


def _read(arrays: Arrays) -> dict[str, PlannedFile]:
    told = json.loads(arrays["told"].tobytes())
    files: dict[str, PlannedFile] = {}
    for number, (name, one) in enumerate(told.items()):
        every = [int(each) for each in one["every"]]
        if len(every) > _PARTS or not all(1 <= each <= _EVERY for each in every):
            raise ValueError(f"parts every {every} actions")
        programs = [
            Program.unpacked(arrays[f"{number} program {index}"].tobytes())
            for index in range(len(every))
        ]
        files[str(name)] = PlannedFile(
            inputs=read_specs(one["inputs"]),
            parts=tuple(zip(every, programs, strict=True)),
            first={str(key): arrays[f"{number} first {key}"] for key in one["first"]},
        )
    return files


def listed(specs: tuple[InputSpec, ...]) -> list[dict[str, Any]]:
    """Return inputs of a file as JSON has them, for `read_specs`."""
    return [
        {"name": one.name, "shape": one.shape, "dtype": one.dtype.str, "is_list": one.is_list}
        for one in specs
    ]


def read_specs(listed_specs: Any) -> tuple[InputSpec, ...]:
    """Return inputs of a file as its process says them.

    Raises:
        TypeError, ValueError, KeyError: it says something else.
    """
    return tuple(
        InputSpec(
            name=str(one["name"]),
            shape=tuple(None if side is None else int(side) for side in one["shape"]),
            dtype=np.dtype(str(one["dtype"])),
            is_list=bool(one["is_list"]),
        )
        for one in listed_specs
    )


_UNSUPPORTED = "`runtime: nw-eval` does not run it: "


def unsupported_by(error: PolicyError) -> str:
    """Return the operator that an error says nw-eval does not run; empty if it says none."""
    return error.message.partition(_UNSUPPORTED)[2]


def unsupported(where: str, error: Exception) -> PolicyError:
    """Return the error for a file that nw-eval does not run."""
    return PolicyError(
        f"{where}: {_UNSUPPORTED}{clean(error, at_most=200)}",
        fix="write `runtime: native`, or export it with other operators",
    )


class PlannedNetwork:
    """A file of weights as programs, with their memory."""

    def __init__(self, bundle: Bundle, wanted: Wanted) -> None:
        """Open what a file was planned into, for as many outputs as it was planned for."""
        from nw_policies.executor.network import Network

        planned = bundle.programs[bundle.network]
        self._name, self._subject = bundle.name, bundle.subject
        self._count = len(wanted)
        self.inputs = planned.inputs
        self._assemble = InputAssembler(bundle.card, planned.inputs)
        self._parts = tuple((every, Network(program)) for every, program in planned.parts)
        self._first = {name: array.astype(np.float32) for name, array in planned.first.items()}
        self._is_open = True
        self.is_function = not self.remembers
        """Whether equal inputs give equal outputs, whatever came before."""
        self.reset(0)

    @property
    def remembers(self) -> bool:
        """Whether the next outputs depend on more than the next inputs."""
        return bool(self._first) or any(every > 1 for every, _ in self._parts)

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial."""
        self._memory: Arrays = dict(self._first)
        self._step = 0

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the programs that are due.

        Raises:
            TrialError: an input has another size than it was planned for.
        """
        if not self._is_open:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        flat: list[NDArray[Any]] = []
        for one in self._assemble.in_order(observation):
            flat += one if isinstance(one, list) else [one]
        feeds = {f"input {index}": array for index, array in enumerate(flat)} | self._memory
        results: Arrays = {}
        try:
            for every, network in self._parts:
                if self._step % every == 0:
                    results |= network(feeds)
                    for name in self._memory:
                        if NEXT + name in results:
                            feeds[name] = self._memory[name] = results[NEXT + name].copy()
        except (KeyError, ValueError) as error:
            raise TrialError(f"{self._subject} failed: {clean(error, at_most=200)}") from error
        self._step += 1
        return tuple(results[f"{NEXT}output {index}"] for index in range(self._count))

    def state(self) -> bytes:
        """Return what it remembers."""
        if not self.remembers:
            return b""
        return pack(self._memory | {"step": np.array(self._step)})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        if not self.remembers:
            if state:
                raise unfitting(self._name, f"{len(state)} bytes, and it remembers nothing")
            return
        with unpacked(state, self._name) as arrays:
            step = int(arrays.pop("step"))
            shapes = {name: array.shape for name, array in arrays.items()}
            if shapes != {name: array.shape for name, array in self._first.items()}:
                raise unfitting(self._name, f"it has {shapes}")
            self._memory, self._step = arrays, step

    def close(self) -> None:
        """End; a later `run` is an error."""
        self._is_open = False


_KNOWN = 4
_plans: dict[tuple[str, int], Mapping[str, PlannedFile]] = {}


def files_known(bundle: Bundle) -> Mapping[str, PlannedFile] | None:
    """Return the programs of a policy that this process has opened; None if it has not.

    All trials of a process open the same policies.
    """
    return _plans.get((bundle.digest, bundle.joints))


def keep_files(bundle: Bundle, files: Mapping[str, PlannedFile]) -> None:
    """Keep a policy's programs for `files_known`."""
    while len(_plans) >= _KNOWN:
        del _plans[next(iter(_plans))]
    _plans[bundle.digest, bundle.joints] = files


_left: dict[str, str] = {}
"""By digest of a bundle, what of its networks nw-eval does not run, as this process has found."""


def operator_of(bundle: Bundle) -> str:
    """Return the operator of a policy that nw-eval cannot run; empty if none is known.

    Where its card leaves the choice, its own runtime runs it from then on.
    """
    return _left.get(bundle.digest, "")


def leave(bundle: Bundle, operator: str) -> None:
    """Let a policy's own runtime run it: it has an operator that nw-eval does not run."""
    _left[bundle.digest] = operator


def leaves(bundle: Bundle, error: PolicyError) -> bool:
    """Return whether a policy's own runtime is to run it after an error; it is then remembered."""
    operator = unsupported_by(error)
    if bundle.card.runtime is None and operator:
        leave(bundle, operator)
    return bundle.card.runtime is None and bool(operator)


class OpenPolicy(Policy, Protocol):
    """A policy that its own runtime runs, and that can be planned."""

    def planned(self, shown: Observation) -> dict[str, PlannedFile]:
        """Return what its files are planned into for observations of these sizes.

        Raises:
            PolicyError: a file cannot be planned.
        """
        ...


class PlannedPolicy:
    """A policy that is planned at its first action.

    Args:
        bundle: of the policy.
        start: opens it to be planned; it is closed when it has been. Where it cannot be planned,
            and the card leaves the choice, it stays.
        build: opens the bundle with its programs.

    Raises:
        PolicyError: as `start`.
    """

    def __init__(
        self, bundle: Bundle, start: Callable[[], OpenPolicy], build: Callable[[Bundle], Policy]
    ) -> None:
        self._bundle, self._build = bundle, build
        self._seed, self._state = 0, b""
        self._has_acted = False
        known = files_known(bundle)
        self._unplanned: OpenPolicy | None = None if known else start()
        self._policy: Policy | None = self._built(known) if known else None

    def _built(self, files: Mapping[str, PlannedFile]) -> Policy:
        return self._build(self._bundle.with_changes(programs=files))

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        return () if self.policy is None else self.policy.inputs

    @property
    def network_inputs(self) -> dict[str, tuple[InputSpec, ...]]:
        """What the file of each network declares to take."""
        return getattr(self.policy, "network_inputs", {})

    @property
    def held(self) -> Arrays:
        """By name, what the networks gave last."""
        return getattr(self._policy, "held", {})

    @property
    def policy(self) -> Policy | None:
        """What was planned; until the first action, what will be; None once it is closed."""
        return self._policy or self._unplanned

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._seed, self._state, self._has_acted = seed, b"", False
        if self._policy is not None:
            self._policy.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Return the raw action for an observation.

        Raises:
            PolicyError: the policy has an operator that nw-eval does not run.
            ActionError, TrialError: as any policy's.
        """
        if self._policy is None:
            if self._unplanned is None:
                raise TrialError(f"{self._bundle.subject} is closed", fix="open it again")
            self._policy = self._planned(self._unplanned, observation)
            if self._policy is not self._unplanned:
                self._unplanned.close()
            self._unplanned = None
            if self._state:
                self._policy.restore(self._state)
        self._has_acted = True
        return self._policy.act(observation)

    def _planned(self, unplanned: OpenPolicy, observation: Observation) -> Policy:
        try:
            files = unplanned.planned(observation)
        except PolicyError as error:
            if not leaves(self._bundle, error):
                raise
            unplanned.reset(self._seed)  # It may remember what was recorded.
            return unplanned
        keep_files(self._bundle, files)
        return self._built(files)

    def state(self) -> bytes:
        """Return what it remembers; nothing before its first action.

        So it is the same whether the process has planned it before or not.
        """
        if self._policy is None or not self._has_acted:
            return self._state
        return self._policy.state()

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        self._state, self._has_acted = state, False
        if self._policy is not None:
            self._policy.restore(state) if state else self._policy.reset(0)

    def close(self) -> None:
        """Free what it holds."""
        for each in (self._unplanned, self._policy):
            if each is not None:
                each.close()
        self._unplanned = None
