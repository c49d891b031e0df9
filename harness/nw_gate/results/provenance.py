"""Where results come from: run.json, written when a run starts and again when it ends.

And what it says about code, machine and library versions.
"""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from math import ceil
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from nw_base import __version__
from nw_base.clean import clean
from nw_base.digest import digest_of
from nw_base.errors import StoreError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import bounded_bytes
from nw_base.words import PanelKind, Projection, RasterizeMode
from nw_gate.results.labels import check_labels
from nw_gate.results.request import Request
from nw_gate.results.seal import seal, unseal
from nw_gate.scores import ScoreSpec

_MOST = 16 * 2**20
"""Bytes of a run.json that is read: some 50,000 scenes."""

_RECHECK = "recheck/"
_ROUNDS = "rounds/"
_SEARCH = "search/"


def rounds_key(policy: PolicyInfo) -> str:
    """Return the key by which a baseline's own policy meets as many starts of each scene.

    It follows from its files: they are what says that it is the baseline's own.
    """
    return f"{_ROUNDS}{policy.checkpoint_digest}/{policy.card_digest}"


def search_key(key: str) -> str:
    """Return the key of an order of which a search for a limit runs what it needs.

    Args:
        key: of the policy, by which the order is drawn.
    """
    return f"{_SEARCH}{key}"


def candidate_in(key: str) -> str:
    """Return by what the starts are drawn of an order with this key: see `RunInfo.drawn_for`."""
    return key.removeprefix(_ROUNDS).removeprefix(_SEARCH)


def recheck_key(seed: int) -> str:
    """Return the key by which the starts that run again of a baseline's own policy are ordered.

    Args:
        seed: which could not be predicted when the baseline was written.
    """
    return f"{_RECHECK}{seed}"


class _Saved(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class FetchedInfo(_Saved):
    """What of a run came from a hub, and which revision it is."""

    reference: str  # Without a revision: `hub:org/name`, `neverwhere:NAME`, `menagerie:NAME`.
    revision: str  # The commit.
    files: dict[str, str]  # Hex sha256 by name.


class SceneInfo(_Saved):
    """One scene of a run."""

    digest: str
    task: str
    trials: int = Field(ge=0)  # Planned.
    # Whether the policy was trained in it; None: its card names no scene, or it is not built in.
    split: Literal["train", "eval"] | None = None
    fetched: FetchedInfo | None = None  # None: it lay on the machine.
    rasterize_mode: RasterizeMode | None = None  # Of a splat file that says one, where it is drawn.
    projection: Projection | None = None  # As above: how its Gaussians became pixels in training.


def depends(reason: str) -> str:
    """Return the sentence that says why results are not the same on every processor."""
    return f"its results depend on the processor: {reason}"


class PolicyInfo(_Saved):
    """The policy of a run."""

    name: str
    adapter: str = ""
    card_digest: str = ""
    checkpoint_digest: str
    # Hex sha256 of network and card without names and metadata (`Bundle.computes`); empty: unknown.
    computes: str = ""
    card: str = ""  # Path of the card, for --resume.
    origin: str = ""  # What the digest is of where there are no weights: server, code.
    depends_on: str = ""  # What makes its results depend on the processor; empty: nothing does.
    fetched: FetchedInfo | None = None  # None: it lay on the machine.

    @property
    def folder_name(self) -> str:
        """What pages call it: its folder's name; the card's for a fetched one or an object."""
        card = PurePath(self.card)
        if self.fetched is not None or not card.parent.name:
            return self.name
        return card.parent.name if card.name == "policy.yaml" else card.stem

    @property
    def short_digest(self) -> str:
        """Eight hex digits that tell cards and checkpoints of one name apart."""
        return digest_of([self.card_digest, self.checkpoint_digest])[:8]

    @property
    def dependence(self) -> str:
        """Sentence on what its results depend; empty where that is nothing, or is not known."""
        return depends(self.depends_on) if self.depends_on else ""

    @property
    def key(self) -> str:
        """What starts are drawn by: what the policy computes, so that a re-export meets the same.

        Where that is unknown, or an older nw-eval wrote the file, the checkpoint with its card.
        """
        return self.computes or f"{self.checkpoint_digest}/{self.card_digest}"


class CodeInfo(_Saved):
    """The code that ran."""

    version: str
    digest: str  # Hex sha256 of the package's Python files.
    commit: str = ""  # Empty outside a Git checkout.
    dirty: bool = False


class MachineInfo(_Saved):
    """The machine that it ran on."""

    host: str
    cpu: str
    cores: int
    system: str
    python: str


class BaselineInfo(_Saved):
    """The baseline that a run is compared with, and what its policy did on this machine.

    The run's folder has a copy of the baseline: whoever judges the run again needs no other file.
    """

    name: str
    path: str  # Of its file, absolute.
    sha256: str  # Hex, of the file.
    # "scores" is of an older nw-eval, which ran no control.
    checked: Literal["bits", "control", "scores"] | None = None
    """What trials of the baseline's policy showed on this class of machine: the baseline's bits,
    or scores in line with it; None without any, because the baseline has results of it."""
    moved: tuple[str, ...] = ()
    """Sentences: in what the baseline's policy differs here from the baseline. Where there
    are any, the run is INVALID, and no trial of the candidate has run."""


class CacheInfo(_Saved):
    """How a run used the cache of trials. Which results it took over, rows say: `Row.cached`."""

    off: str = ""  # Why it was not used; empty if it was.
    reexecuted: int = Field(default=0, ge=0)
    """Trials that ran although the cache had their result, to be compared with it."""
    differing: tuple[str, ...] = ()
    """Sentences: which of these came out otherwise. Where there are any, the run is INFRASTRUCTURE:
    what else was taken over may be as wrong."""

    def after(self, earlier: CacheInfo | None) -> CacheInfo:
        """Return what a run has to say whose last session says this, and those before `earlier`."""
        if earlier is None:
            return self
        return CacheInfo(
            off=self.off if earlier.off else "",
            reexecuted=earlier.reexecuted + self.reexecuted,
            differing=(*earlier.differing, *self.differing),
        )


class ShardInfo(_Saved):
    """Which part of a run a run is."""

    index: int = Field(ge=1)
    count: int = Field(ge=1)
    plan: str  # Hex sha256 of the whole plan: see `engine.order`.

    @model_validator(mode="after")
    def _in_range(self) -> Self:
        if self.index > self.count:
            raise ValueError(f"part {self.index} of {self.count}")
        return self

    def __str__(self) -> str:
        return f"part {self.index} of {self.count}"


class PartInfo(_Saved):
    """A part of a run that was merged. Times are UTC in ISO 8601, wall_s is s."""

    shard: ShardInfo
    id: str
    started: str
    finished: str | None
    wall_s: float = Field(ge=0.0)
    workers: int
    host: str
    rows_digest: str
    cache: CacheInfo | None = None


class StopInfo(_Saved):
    """Which trials of a drawn order were enough: what was run beyond them is not judged."""

    first: int = Field(ge=0)  # All at places below it.
    followed: tuple[int, ...] = ()  # Later places, judged for their scenes alone, in order.
    trials: dict[str, int] = {}  # How many these are, by scene.

    def wants(self, place: int | None) -> bool:
        """Return whether the trial at an index is one of them."""
        return place is not None and (place < self.first or place in self.followed)


class RunInfo(_Saved):
    """Everything about a run that its rows do not say. Times are UTC in ISO 8601, wall_s is s."""

    # Version of this file. In version 1 an order was drawn round by round, not trial by trial.
    run: int = Field(2, ge=1, le=2)
    id: str
    started: str
    finished: str | None = None
    wall_s: float = Field(default=0.0, ge=0.0)
    interrupted: bool = False
    stop: StopInfo | None = None  # None: no trial was left out.
    request: Request | None = None  # What was asked for, for --resume; older files do not say.
    suite_file: str
    suite_folder: str = ""  # Absolute; where the suite's relative paths start, for --resume.
    suite: dict[str, Any]  # The resolved suite, as `Suite.model_dump(by_alias=True)` gives it.
    suite_digest: str
    scores: dict[str, ScoreSpec] = {}  # What its trials are measured by, as it was declared then.
    policy: PolicyInfo
    robot_fetched: FetchedInfo | None = None  # None: it lay on the machine.
    own_policy: bool = True  # Of the suite: only then its own baseline counts.
    scenes: dict[str, SceneInfo]
    left_out: tuple[str, ...] = ()  # Scenes of the suite that the run was not to have, by name.
    panel: PanelKind = "pinned"  # Fresh: the suite's seed follows from the policy's `key`.
    drawn_from: int | None = None  # Starts of the baseline that drew the order; None = 0, 1, 2, ...
    # Whose order it meets them in, if not its policy's: the key of another policy, or of the draw
    # of what runs again (`recheck_key`).
    drawn_for: str | None = None
    shard: ShardInfo | None = None  # None: no part of another run.
    parts: tuple[PartInfo, ...] = ()  # Of which it was merged; none where it was run whole.
    baseline: BaselineInfo | None = None  # None: nothing to compare with.
    workers: int = 1
    renderer: str = ""  # Backend and preset, such as "cpu gsplat-1.5".
    cache: CacheInfo | None = None  # None: of an older nw-eval, which had none.
    # What its user calls it: `labels.KNOWN` from CI's variables, and what was typed. Names alone.
    labels: dict[str, str] = {}
    fence: str = ""  # The operating system's round workers: "landlock 7, seccomp", or why none.
    command: tuple[str, ...] = ()
    code: CodeInfo
    machine: MachineInfo
    versions: dict[str, str] = {}
    engine: dict[str, str] = {}  # What makes bits differ: `JournalHeader.engine`.
    # Of installed packages that its trials ran: "axes.NAME": "package version sha256-of-its-code".
    plugins: dict[str, str] = {}
    rows_digest: str = ""  # Of the rows that are judged; empty until the run has ended.
    trials_sha256: str = ""  # Hex, of trials.parquet; as above.
    journal_sum: str = ""  # Of the journal that these rows were taken from; as above.
    merkle_root: str = ""  # Hex, of these rows, their logs and what they are of; as above.

    @field_validator("labels")
    @classmethod
    def _are_labels(cls, labels: dict[str, str]) -> dict[str, str]:
        return check_labels(labels)

    @property
    def drawn_by(self) -> str:
        """By what the order of its starts is drawn, where a baseline draws it."""
        return candidate_in(self.drawn_for or self.policy.key)

    @property
    def goes_by_rounds(self) -> bool:
        """Whether its policy is the baseline's own, and all its trials run: of each scene as many.

        Nothing is compared then, so that no random order is needed.
        """
        return self.drawn_for is not None and self.drawn_for.startswith(_ROUNDS)

    @property
    def is_recheck(self) -> bool:
        """Whether its policy is the baseline's own, of which some starts run again."""
        return self.drawn_for is not None and self.drawn_for.startswith(_RECHECK)

    @property
    def is_search(self) -> bool:
        """Whether a search for a limit chose its trials by the results of earlier ones.

        Success over all of them estimates nothing.
        """
        return self.drawn_for is not None and self.drawn_for.startswith(_SEARCH)

    @property
    def is_part(self) -> bool:
        """Whether it is one of several parts of a run, of which none is judged alone."""
        return self.shard is not None and self.shard.count > 1

    @property
    def planned(self) -> dict[str, int]:
        """Planned trials by scene: those that were enough, if a part of them was."""
        trials = {name: scene.trials for name, scene in self.scenes.items()}
        if self.stop is None:
            return trials
        return {name: self.stop.trials.get(name, 0) for name in trials}


def write_run_info(path: Path, info: RunInfo) -> None:
    """Write run.json with its checksum, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(seal(info.model_dump_json(indent=2))[0], encoding="utf-8")


def read_run_info(path: Path) -> RunInfo:
    """Read run.json.

    Raises:
        StoreError: it is missing or damaged.
    """
    fix = "run again or restore it"
    try:
        data = bounded_bytes(path, _MOST)
        info = RunInfo.model_validate_json(data)
        unseal(data)
    except FileNotFoundError:
        raise StoreError(f"no run at {path.parent}", fix="name a folder with a run.json") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        reason = clean(f"{place}: {first['msg'].lower()}", at_most=300)
        raise StoreError(f"{path} is damaged: {reason}", fix=fix) from None
    except ValueError as error:
        raise StoreError(f"{path} is damaged: {error}", fix=fix) from None
    return info


LIBRARIES = ("mujoco", "numpy", "torch", "onnxruntime", "numba", "pyarrow")
"""Whose versions may change results or how they are kept."""


PACKAGES = (
    *("nw_base", "nw_eval", "nw_gate", "nw_learn", "nw_places"),
    *("nw_policies", "nw_scenes", "nw_sim", "nw_splat", "nw_twin"),
)
"""The packages of nw-eval, side by side under one folder."""

JUDGING = frozenset(
    {"nw_learn", "nw_twin"}
    | {f"nw_base/{name}" for name in ("__init__", "clean", "errors", "plural", "public", "words")}
    | {f"nw_eval/{name}" for name in ("__init__", "__main__", "api", "cli", "pytest_plugin")}
    | {f"nw_eval/{name}" for name in ("reporting", "testing", "view", "viewing")}
    | {f"nw_gate/{name}" for name in ("__init__", "absolute", "baseline", "bisection", "cause")}
    | {f"nw_gate/{name}" for name in ("cli", "episodes", "judgement", "ledger", "ledger_report")}
    | {f"nw_gate/{name}" for name in ("results", "settings")}
    | {f"nw_gate/{name}" for name in ("side_by_side", "stats", "sweep", "validity", "verdict")}
    | {"nw_policies/drafting", "nw_scenes/hub", "nw_sim/probe"}
)
"""Packages and rooms that no bit of a row comes from: they say what is to be run, fetch it, keep
rows, judge them, show logs, or make policies and places. All others count, those that are added
too."""

_ROOT = Path(__file__).resolve().parents[2]


@cache
def rows_code_digest() -> str:
    """Return the hex sha256 of the code that makes rows: all rooms but those that only judge.

    The robots that come with it count as code, since rows name them by their names alone.

    A report may be worded anew, and a run still be resumed, and a baseline still be of this
    machine.
    """
    return _digest(path for path in _sources() if not JUDGING & _rooms(path))


@cache
def code_info() -> CodeInfo:
    """Return version and content of the code, and the commit of its checkout if it has one."""
    commit = _git(_ROOT, "rev-parse", "HEAD")
    return CodeInfo(
        version=__version__,
        digest=_digest(_sources()),
        commit=commit,
        dirty=bool(commit) and bool(_git(_ROOT, "status", "--porcelain", "--", str(_ROOT))),
    )


def machine_info() -> MachineInfo:
    """Return what the machine says about itself."""
    return MachineInfo(
        host=platform.node(),
        cpu=_cpu_name(),
        cores=usable_cores(),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=platform.python_version(),
    )


def processors() -> tuple[int, int]:
    """Return how many processors this process may run on, and how many there are."""
    installed = os.cpu_count() or 1
    has_affinity = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if has_affinity else installed, installed


def usable_cores(root: Path = Path("/")) -> int:
    """Return the number of cores that this process may use; everything that counts cores asks here.

    The least of two: the processors it may run on (sched_getaffinity(2)), and the processor time
    that its control groups may take, rounded up (cpu.max of cgroups v2, cpu.cfs_quota_us of v1, see
    Linux's Documentation/admin-guide/cgroup-v2.rst and scheduler/sched-bwc.rst). Containers are
    limited by the latter.

    Args:
        root: of the file system, which says the control groups.
    """
    cores, _ = processors()
    try:
        quotas = [_quota(folder, is_v2=is_v2) for folder, is_v2 in _cgroups(root)]
    except (OSError, ValueError):  # No Linux, or no control groups.
        quotas = []
    return max(1, min([cores, *(ceil(quota) for quota in quotas if quota is not None)]))


def library_versions() -> dict[str, str]:
    """Return installed versions without importing anything."""
    versions: dict[str, str] = {}
    for name in LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def _sources() -> list[Path]:
    paths = [path for name in PACKAGES for path in (_ROOT / name).rglob("*.py")]
    return sorted([*paths, *_ROOT.glob("nw_scenes/robots/*/robot.*")])


def _rooms(source: Path) -> set[str]:
    """Return the package of a source, and its room there: a folder, or the file itself."""
    package, room, *_ = source.relative_to(_ROOT).parts
    return {package, f"{package}/{room.removesuffix('.py')}"}


def _digest(sources: Iterable[Path]) -> str:
    content = sha256()
    for path in sources:
        content.update(path.relative_to(_ROOT).as_posix().encode() + b"\0")
        content.update(sha256(path.read_bytes()).digest())
    return content.hexdigest()


def _cgroups(root: Path) -> Iterator[tuple[Path, bool]]:
    """Yield the folders of this process's control groups of processor time, and their parents.

    Args:
        root: of the file system.

    Yields:
        The folder, and whether it is of version 2.

    Raises:
        OSError: this system has none.
    """
    mounted = root / "sys/fs/cgroup"
    for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
        _, controllers, name = line.split(":", 2)
        own = name.strip("/")
        if not controllers:
            # A container may see its own group as the root, by either name.
            for folder in dict.fromkeys((mounted / own, *_parents(mounted, own), mounted)):
                yield folder, True
        elif "cpu" in controllers.split(","):
            for kind in (controllers, "cpu"):
                base = mounted / kind
                for folder in dict.fromkeys((base / own, *_parents(base, own), base)):
                    yield folder, False


def _parents(base: Path, own: str) -> list[Path]:
    return [base / parent for parent in PurePosixPath(own).parents if str(parent) != "."]


def _quota(folder: Path, *, is_v2: bool) -> float | None:
    """Return how many cores a control group may use at a time; None = as many as there are."""
    try:
        if is_v2:
            quota, period = (folder / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota, period = (
                (folder / f"cpu.cfs_{word}_us").read_text(encoding="utf-8").strip()
                for word in ("quota", "period")
            )
        share = float(quota) / float(period)  # `max` is no number.
    except (OSError, ValueError, ZeroDivisionError):
        return None
    return share if share > 0 else None  # -1 is version 1's `max`.


def _cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _git(folder: Path, *arguments: str) -> str:
    """Return what git says about the packages' own checkout; empty where there is none."""
    if not (folder.parent / ".git").exists():
        return ""  # An installed wheel may lie in somebody else's repository.
    try:
        done = subprocess.run(  # noqa: S603  # Fixed arguments, no shell.
            ["git", "-C", str(folder), *arguments],  # noqa: S607  # Whichever git the user has.
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
