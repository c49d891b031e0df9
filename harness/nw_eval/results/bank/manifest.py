"""What a bank says of itself: who made it, when, why, and what must match for it to hold."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field

from nw_eval.files.shipped import available
from nw_eval.results.provenance import RunInfo

_SIMULATOR = ("mujoco", "embreex", "renderer")
"""Parts of `RunInfo.engine` that are the simulated world: in another version it is another one."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class BankKey(_Part):
    """What a bank holds for, and nothing else: each field is named where it does not match."""

    suite_digest: str
    """Of robot, protocol, seed, episode and perturbations: what names the starts."""
    seed: int
    protocol: str
    scenes: dict[str, str]
    """Digests of the scenes by name."""
    simulator: dict[str, str]
    """Versions of what makes the simulated world: mujoco, embreex, renderer."""


class BankPolicy(_Part):
    """The baseline's policy."""

    name: str
    card_digest: str
    checkpoint_digest: str
    card: str = ""
    """Where its card was, for a machine that the bank has not seen: a shipped bundle's name, or a
    path from the folder of the run."""

    @property
    def typed(self) -> str:
        """What a command's --policy is to say: PATH where it lay outside the project."""
        if self.card or self.name in available("policies"):
            return self.card or self.name
        return "PATH"


class PanelInfo(_Part):
    """One class of machine on which all starts were run."""

    machine: dict[str, str]
    """What decides the bits of arithmetic besides the simulator: kind of processor, versions of
    numerical libraries, digest of nw-eval's code."""
    saved: str
    """When, UTC in ISO 8601."""
    by: str
    """Who."""
    rows_digest: str
    """Of the rows that the panel is made from."""


class Manifest(_Part):
    """All that a bank says of itself."""

    bank: int = Field(1, description="Version of this format.")
    name: str
    suite: str
    """The suite's name."""
    note: str = ""
    """Why it was made."""
    starts: int = Field(ge=1)
    """M: starts in each scene and perturbation."""
    key: BankKey
    policy: BankPolicy
    panels: tuple[PanelInfo, ...] = Field(min_length=1)


def key_of(run: RunInfo) -> BankKey:
    """Return what a bank must have to be compared with a run."""
    return BankKey(
        suite_digest=run.suite_digest,
        seed=int(run.suite.get("seed", 0)),
        protocol=str(run.suite.get("protocol", "")),
        scenes={name: scene.digest for name, scene in run.scenes.items()},
        simulator={name: run.engine[name] for name in _SIMULATOR if name in run.engine},
    )


def machine_of(run: RunInfo) -> dict[str, str]:
    """Return the class of machine that a run was made on."""
    return machine_in(run.engine)


def machine_in(engine: Mapping[str, str]) -> dict[str, str]:
    """Return the class of machine that `RunInfo.engine` names."""
    return {name: value for name, value in engine.items() if name not in _SIMULATOR}
