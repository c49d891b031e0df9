"""Configs of training programs: YAML files, read and refused as suites are.

Also here: the device that a config's `device` names.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError

from nw_base.digest import digest_of
from nw_base.errors import PrerequisiteError, UsageError, nearest
from nw_base.files.inside import what_is
from nw_base.files.shipped import shipped
from nw_base.files.yaml_file import YamlProblems, read_yaml, validation_problems

if TYPE_CHECKING:
    import torch

DeviceName = Literal["auto", "cpu", "cuda"]
"""Where networks learn; `auto` takes CUDA where there is one."""


class ConfigModel(BaseModel):
    """A frozen part of a config; a key that it does not know is an error, as are inf and NaN."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )


class Budget(ConfigModel):
    """When a training has had enough."""

    steps: int = Field(ge=1, le=10**12)
    """Steps of the whole training, as its curve counts them: control steps of a teacher, samples
    that a student has learnt from. Phases and schedules are shares of this."""
    minutes: float | None = Field(None, gt=0.0)
    """Minutes after which this process stops and keeps its state, to be resumed. The clock ends a
    training sooner; it never changes what a step learns."""


class ConfigFile(ConfigModel):
    """A config as a file; it knows where it was read from."""

    _file: Path = PrivateAttr(default_factory=Path)

    @property
    def base(self) -> Path:
        """The folder that relative paths of the file start from."""
        return self._file.parent

    def read_from(self, path: Path) -> Self:
        """Remember the file; it is no setting."""
        self._file = path
        return self


class TrainingConfig(ConfigFile):
    """What the config of every training program says."""

    version: Literal[1] = Field(alias="nw-train")
    """Version of this format."""
    seed: int = Field(ge=0, lt=2**63)
    """All randomness follows from it."""
    device: DeviceName = "auto"
    """Where networks learn. The same curve from the same seed holds on one kind of device."""
    budget: Budget
    keep_every: int = Field(1_000_000, ge=1)
    """Steps from one kept checkpoint to the next. The state to go on with is written every few
    minutes anyway."""

    @property
    def digest(self) -> str:
        """Hex sha256 of what decides the curve: all but the device and the minutes."""
        fields = self.model_dump(mode="json", by_alias=True, exclude={"device"})
        del fields["budget"]["minutes"]
        return digest_of(fields)


def find_config(name_or_path: str | Path, *, folder: str = "") -> Path:
    """Return the path of a config: `teacher` is `training/teacher.yaml`, here or as shipped.

    Args:
        name_or_path: of the config.
        folder: within `training/`, in which names are looked up.

    Raises:
        UsageError: there is no such config; names the nearest one.
    """
    path = Path(name_or_path)
    if what_is(path) == "file":
        return path
    # Packed beside the suites, in the wheel as in a checkout.
    folders = (shipped("suites").parent / "training" / folder, Path("training") / folder)
    known = {file.stem: file for each in folders for file in each.glob("*.yaml")}
    if str(name_or_path) in known:
        return known[str(name_or_path)]
    raise UsageError(f"no config {str(name_or_path)!r}", fix=nearest(path.stem, known))


M = TypeVar("M", bound=ConfigFile)


def load_config(path: Path, kind: type[M]) -> M:
    """Read a config.

    Raises:
        UsageError: all problems of the file, one line each, with file, line and column.
    """
    try:
        file = read_yaml(path)
    except YamlProblems as error:
        raise UsageError(error.problems) from None
    try:
        return kind.model_validate(file.data).read_from(path)
    except ValidationError as error:
        raise UsageError(validation_problems(error, file, kind)) from None


def device_of(name: DeviceName) -> torch.device:
    """Return the device of a name; `auto` is CUDA where there is one.

    Raises:
        PrerequisiteError: it is `cuda`, and there is none.
    """
    import torch

    has_cuda = torch.cuda.is_available()
    if name == "cuda" and not has_cuda:
        raise PrerequisiteError("device: cuda, and there is no CUDA here", fix="set device: auto")
    return torch.device("cuda" if has_cuda and name != "cpu" else "cpu")


def one_thread() -> None:
    """Let torch compute in one thread: sums come in one order, and processes share the cores."""
    import torch

    torch.set_num_threads(1)
