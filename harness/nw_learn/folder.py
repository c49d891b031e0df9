"""The folder of a training: all that it needs to go on, and all that it has to show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nw_base.clean import clean
from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import regular

_MOST = 4 * 2**30
"""Of a state that is read."""
_CHECKPOINT = re.compile(r"(\d{4,9})\.pt", re.ASCII)

State = Mapping[str, Any]
"""Tensors, numbers, texts, and lists and mappings of them, as `torch.load(weights_only=True)` takes
them; the states of NumPy's generators are such mappings."""


class TrainFolder:
    """A training's folder.

        config.yaml      as it was when the training began
        state.pt         everything to go on with; the last one, whole at any time
        checkpoints/     networks that were kept, 0001.pt and on
        curve.parquet    what was measured on the way, and curve.png of it
        tensorboard/     the same for TensorBoard, where that is installed

    Foreign code is never run: states are read as weights alone, and nothing is read through a link
    that leads out of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def begin(cls, path: Path, config: Path) -> TrainFolder:
        """Make a folder for a new training, with a copy of its config.

        Raises:
            UsageError: a training is in it already.
            StoreError: it cannot be written.
        """
        folder = cls(path)
        if folder.config.exists() or folder.state.exists():
            raise UsageError(
                f"{path} holds a training already",
                fix="choose another --out, or resume it with --resume",
            )
        text = regular(config).read_bytes()
        with atomic_path(folder.config) as temporary:
            temporary.write_bytes(text)
        return folder

    @classmethod
    def resume(cls, path: Path) -> TrainFolder:
        """Return the folder of a training that can go on.

        Raises:
            UsageError: no training is in it.
        """
        folder = cls(path)
        if not folder.config.is_file():
            raise UsageError(f"no training in {path}", fix="name a folder with a config.yaml")
        return folder

    @property
    def config(self) -> Path:
        """The copy of the config."""
        return self.path / "config.yaml"

    @property
    def state(self) -> Path:
        """The file of the newest state."""
        return self.path / "state.pt"

    @property
    def checkpoints(self) -> tuple[Path, ...]:
        """The kept checkpoints, oldest first."""
        files = (self.path / "checkpoints").glob("*.pt")
        kept = [path for path in files if _CHECKPOINT.fullmatch(path.name)]
        return tuple(sorted(kept, key=lambda path: int(path.stem)))

    def save_state(self, state: State) -> None:
        """Replace the state, whole or not at all.

        Raises:
            StoreError: it cannot be written.
        """
        save(self.state, state)

    def load_state(self) -> dict[str, Any] | None:
        """Return the newest state; None where the training was ended before it had one.

        Raises:
            StoreError: the file is damaged, or no state.
        """
        return self.read(self.state) if self.state.exists() else None

    def keep(self, number: int, state: State) -> Path:
        """Keep a checkpoint beside the earlier ones, and return its path.

        Raises:
            StoreError: it cannot be written.
        """
        path = self.path / "checkpoints" / f"{number:04d}.pt"
        save(path, state)
        return path

    def checkpoint(self, number: int | None) -> Path:
        """Return the file of a kept checkpoint; None = of the newest state.

        Raises:
            UsageError: there is none.
        """
        if number is None:
            if not self.state.is_file():
                raise UsageError(f"{self.path} has no state yet", fix="wait a few minutes")
            return self.state
        for path in self.checkpoints:
            if int(path.stem) == number:
                return path
        known = ", ".join(str(int(path.stem)) for path in self.checkpoints) or "none yet"
        raise UsageError(f"{self.path} has no checkpoint {number}", fix=f"there are: {known}")

    def forget_after(self, number: int) -> None:
        """Remove checkpoints beyond a number: a training that went back will make them again."""
        for path in self.checkpoints:
            if int(path.stem) > number:
                path.unlink()

    def read(self, path: Path) -> dict[str, Any]:
        """Return the state in a file of this folder.

        Raises:
            StoreError: as `read_state`; or a link leads out of the folder.
        """
        if not path.resolve().is_relative_to(self.path.resolve()):
            raise StoreError(f"{path} is a link out of its folder", fix="put the file itself there")
        return read_state(path)


def save(path: Path, state: State) -> None:
    """Write a state, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    import torch

    with atomic_path(path) as temporary:
        torch.save(dict(state), temporary)


def read_state(path: Path) -> dict[str, Any]:
    """Return the state in a file; its code, if a third party put some there, is not run.

    Raises:
        StoreError: it is missing, too large, damaged, or holds more than weights.
    """
    import torch

    try:
        size = path.stat().st_size
        state = torch.load(path, map_location="cpu", weights_only=True) if size <= _MOST else None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check the path") from None
    except Exception as error:  # noqa: BLE001 - torch fails in any way.
        reason = clean(str(error).partition("\n")[0], at_most=200) or type(error).__name__
        raise StoreError(
            f"{path} is not a training state: {reason}", fix="use an earlier checkpoint"
        ) from None
    if not isinstance(state, dict):
        fault = f"over {_MOST // 2**30} GiB" if size > _MOST else f"a {type(state).__name__}"
        raise StoreError(f"{path} is not a training state but {fault}", fix="check the path")
    return {str(key): value for key, value in state.items()}
