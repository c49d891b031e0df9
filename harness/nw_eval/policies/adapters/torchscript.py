"""TorchScript checkpoints, run on the CPU on one thread."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from pathlib import PurePosixPath
from typing import Any

import torch

from nw_eval.arrays import pack
from nw_eval.errors import PolicyError, TrialError
from nw_eval.policies.adapters.script_state import (
    read_state,
    same,
    state_slots,
    write_state,
)
from nw_eval.policies.bundle import SIZE_LIMIT, Bundle
from nw_eval.policies.inputs import InputAssembler
from nw_eval.policies.memory import unfitting, unpack
from nw_eval.policies.policy import Action, InputSpec, Observation, checked_action
from nw_eval.policies.safety import check_torchscript

# All operators of TorchScript that read or write files; a script may run while it is loaded.
_FILE_OPERATORS = re.compile(rb"\b(save|from_file|load_tensor)\b")


class TorchScriptPolicy:
    """A scripted or traced module that takes observations and returns an action.

    Buffers, and whatever else its code writes to, are its recurrent state, as rsl_rl exports it:
    a trial begins with what the file holds of them.

    `torch.jit.load` reads TorchScript only: no Python pickle of the file is executed, and files
    whose script names one of the few operators that touch the disk are refused unread. Inputs are
    passed in the order of the card's `inputs`.
    """

    inputs: tuple[InputSpec, ...] = ()
    """TorchScript files do not declare shapes."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        self._name = bundle.name
        self._joints = joints
        # More threads change the order of sums, and with it the last bits of an action.
        torch.set_num_threads(1)
        self._module: Any = _open(bundle)
        self._assemble = InputAssembler(bundle.card, self.inputs)
        self._slots = state_slots(self._module, str(bundle.checkpoint))
        self._first = read_state(self._module, self._slots)

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial with the state that the file holds."""
        if self._module is not None:
            write_state(self._module, self._slots, self._first)

    def act(self, observation: Observation) -> Action:
        """Run the module once."""
        if self._module is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        tensors = [torch.from_numpy(array) for array in self._assemble(observation).values()]
        try:
            with torch.inference_mode():
                raw = self._module.forward(*tensors)
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1]
            fix = "export it in float32: module.float()" if "dtype" in reason else None
            raise TrialError(f"policy {self._name!r} failed: {reason}", fix=fix) from error
        if isinstance(raw, tuple | list):
            raw = raw[0]
        if not isinstance(raw, torch.Tensor):
            raise TrialError(f"policy {self._name!r} returned a {type(raw).__name__}, no tensor")
        return checked_action(raw.numpy(), joints=self._joints, policy=self._name)

    def state(self) -> bytes:
        """Return the state where it differs from the file's, as bytes."""
        if self._module is None:
            return b""
        now = read_state(self._module, self._slots)
        return pack(
            {path: array for path, array in now.items() if not same(array, self._first[path])}
        )

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        arrays = unpack(state, self._name)
        for path, array in arrays.items():
            if path not in self._first or self._first[path].dtype != array.dtype:
                raise unfitting(self._name, f"it has {path!r} of {array.dtype}")
        if self._module is not None:
            write_state(self._module, self._slots, self._first | arrays)

    def close(self) -> None:
        """Free the module."""
        self._module = None


def _open(bundle: Bundle) -> Any:
    data = bundle.read_checkpoint()
    _check_archive(data, bundle)
    check_torchscript(data, str(bundle.checkpoint))
    try:
        with warnings.catch_warnings():
            # torch recommends torch.export for new files; the ones that people have are these.
            warnings.simplefilter("ignore", DeprecationWarning)
            module = torch.jit.load(io.BytesIO(data), map_location="cpu")
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[0]
        raise PolicyError(
            f"{bundle.checkpoint}: not a usable TorchScript file: {reason}",
            fix="save it with torch.jit.save",
        ) from None
    module.eval()
    return module


def _check_archive(data: bytes, bundle: Bundle) -> None:
    """Refuse archives that are no TorchScript, or unpack to too much, or reach for files."""

    def refuse(what: str, fix: str) -> PolicyError:
        return PolicyError(f"{bundle.checkpoint}: {what}", fix=fix)

    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        members = archive.infolist()
    except zipfile.BadZipFile:
        raise refuse("not a TorchScript file: it is no archive", "use torch.jit.save") from None
    unpacked = sum(member.file_size for member in members)
    if unpacked > SIZE_LIMIT:
        raise refuse(
            f"the archive unpacks to {unpacked / 2**20:.0f} MiB, over the limit of "
            f"{SIZE_LIMIT // 2**20}",
            "save the actor alone",
        )
    for member in members:
        path = PurePosixPath(member.filename)
        if path.is_absolute() or ".." in path.parts:
            raise refuse(f"the archive has the member {member.filename!r}", "do not use this file")
    names = [PurePosixPath(member.filename).name for member in members]
    if "constants.pkl" not in names or "model.json" in names:
        raise refuse(
            "not a TorchScript file: it holds a state dict or other objects",
            "save the module with torch.jit.save",
        )
    for member in members:
        if "code" not in PurePosixPath(member.filename).parts:
            continue
        found = _FILE_OPERATORS.search(archive.read(member))
        if found is not None:
            operator = found.group().decode()
            raise refuse(
                f"its script names the operator `{operator}`, which reads or writes files",
                "do not use this file, or rename what is called so and save it again",
            )
