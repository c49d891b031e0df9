"""Robots: one frozen specification each, built in, of an installed package, or of a folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from nw_base.clean import clean
from nw_base.errors import PluginError, RobotError, UsageError, nearest
from nw_base.plugins import ROBOTS, identity_of, imported, installed, subject, warn_if_built_in
from nw_scenes.hub.reference import MENAGERIE, PREFIX, parse
from nw_scenes.robots.spec import CameraMount, RobotSpec, Shape, Triangles

__all__ = [
    "BUILT_IN",
    "CameraMount",
    "FoundRobot",
    "RobotSpec",
    "Shape",
    "Triangles",
    "files_of",
    "find_robot",
    "get_robot",
    "know_robot",
    "robot_folder",
    "robot_names",
]

_SHIPPED = Path(__file__).resolve().parent
"""Where the folders of robots lie that nw-eval comes with."""

BUILT_IN = tuple(sorted(path.parent.name for path in _SHIPPED.glob("*/robot.yaml")))
"""Their names."""

_FOLDER = "robots"
"""Of a project, in which folders of robots are found by name."""
_IN_MENAGERIE = (
    *("agility_cassie", "anybotics_anymal_b", "anybotics_anymal_c", "apptronik_apollo"),
    *("berkeley_humanoid", "booster_t1", "boston_dynamics_spot", "fourier_n1"),
    *("google_barkour_v0", "google_barkour_vb", "pal_talos", "pndbotics_adam_lite"),
    *("robotis_op3", "toddlerbot_2xc", "toddlerbot_2xm", "unitree_a1", "unitree_g1"),
    "unitree_h1",
)
"""Legged robots that MuJoCo Menagerie has and nw-eval does not."""
_ELSEWHERE = frozenset(
    {
        *("a2", "aliengo", "anymal_d", "atlas", "b1", "b2", "b2w", "digit", "go2w", "gr1", "h1_2"),
        *("h2", "k1", "laikago", "lite3", "m20", "r1", "x30"),
    }
)
"""Robots that neither has, whose names are not slips of `go2` or another one."""
_DIGITS = 32
"""Hex digits of a folder's digest in a reference: 128 bits."""


@dataclass(frozen=True, kw_only=True)
class FoundRobot:
    """A robot, and what tells it from another of the same name.

    Attributes:
        spec: the robot.
        identity: empty for a built-in one; of a folder 32 hex digits of the SHA-256 of its files;
            of an installed package `package-version-` and 32 hex digits of its code's.
        folder: where it lies; None = nowhere that files could be sent from.
        notes: sentences about what of it is not drawn, or not simulated.
    """

    spec: RobotSpec
    identity: str = ""
    folder: Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def reference(self) -> str:
        """What suites, jobs and rows call it: its name, with `@` and its identity if it has one."""
        return f"{self.spec.name}@{self.identity}" if self.identity else self.spec.name


_folders: dict[str, Path] = {}
"""Folders of robots that this process was told of, by name: see `know_robot`."""


def robot_names() -> tuple[str, ...]:
    """Return the names that can be asked for here, sorted.

    They are those of built-in robots, of installed packages, of the folders in `robots/` of the
    working directory, and of folders that were found by their paths before.
    """
    local = (path.parent.name for path in Path.cwd().glob(f"{_FOLDER}/*/robot.yaml"))
    return tuple(sorted({*BUILT_IN, *installed(ROBOTS), *local, *_folders}))


def get_robot(reference: str) -> RobotSpec:
    """Return a robot.

    Args:
        reference: as for `find_robot`.

    Raises:
        UsageError: as `find_robot`.
    """
    return find_robot(reference).spec


def find_robot(reference: str, base: Path | None = None) -> FoundRobot:
    """Find a robot by name or by path.

    A name is one of a built-in robot, then of a folder that was found before in this process, of a
    folder in `robots/` of the working directory, or of an installed package. `hub:org/name` and
    `menagerie:NAME` are fetched if they are not on this machine. What has a slash otherwise is the
    path of a folder.

    Args:
        reference: for example `go1`, `./my-robot`, or `name@identity` as `FoundRobot.reference`.
        base: folder that a relative path starts from, by default the working directory.

    Raises:
        UsageError: there is no such robot; the message holds the nearest name.
        RobotError: its folder or package cannot be used, or has another identity.
        FetchError, PrerequisiteError, StoreError: it must be fetched, and cannot be.
    """
    if reference.startswith((PREFIX, MENAGERIE)):
        return _of_fetched(reference)
    if _is_path(reference):
        return _of_folder(Path(base or Path.cwd(), reference))
    name, _, identity = reference.partition("@")
    robot = _named(name)
    if identity and robot.identity != identity:
        where = f" in {robot.folder}" if robot.folder is not None else ""
        raise RobotError(
            f"the robot {name!r}{where} is {robot.identity or 'built in'}, {identity} is meant",
            fix="name the folder that is meant with --robot, or install that version",
        )
    return robot


def robot_folder(reference: str) -> Path | None:
    """Return the folder that a reference means, of which nothing is read.

    Args:
        reference: as for `find_robot`.

    Returns:
        The folder; None = it is a built-in robot's or a package's.

    Raises:
        UsageError: there is no such robot.
    """
    if reference.startswith((PREFIX, MENAGERIE)):
        return _of_fetched(reference).folder
    if _is_path(reference):
        return Path(reference).resolve()
    name = reference.partition("@")[0]
    if name in BUILT_IN:
        return None
    folder = _folders.get(name, Path.cwd() / _FOLDER / name)
    if name in _folders or (folder / "robot.yaml").is_file():
        return folder.resolve()
    if name not in installed(ROBOTS):
        raise _unknown(name)
    return None


def _is_path(reference: str) -> bool:
    return "/" in reference or reference in {".", ".."}


def _unknown(name: str) -> UsageError:
    word = name.lower().replace("-", "_")
    models = [each for each in _IN_MENAGERIE if f"_{word}_" in f"_{each}_"]
    folder = f"your own robot's folder, such as ./{name} (`nw-eval robots init` makes one)"
    if word and models:
        named = " or ".join(f"{MENAGERIE}{model}" for model in models)
        return UsageError(f"unknown robot {name!r}", fix=f"give {named}, or {folder}")
    hint = "" if word in _ELSEWHERE else f"{nearest(name, robot_names())}; "
    return UsageError(f"unknown robot {name!r}", fix=f"{hint}give {folder}")


def know_robot(reference: str, folder: Path | None) -> None:
    """Let `get_robot` find a robot by name in this process.

    Args:
        reference: as `FoundRobot.reference`.
        folder: where it lies; None = it is found by its name anyway.

    Raises:
        RobotError: it would have to be fetched. Logs and runs of third parties fetch nothing.
    """
    if reference.startswith((PREFIX, MENAGERIE)):
        raise RobotError(
            f"a trial of the robot {clean(reference, at_most=100)!r}, which is not its name",
            fix="fetch it, and name its folder with --robot",
        )
    if folder is not None:
        _folders[reference.partition("@")[0]] = folder


def _named(name: str) -> FoundRobot:
    if name in BUILT_IN:
        warn_if_built_in(ROBOTS, name)
        return FoundRobot(spec=_built_in(name))
    folder = robot_folder(name)
    return _of_package(name) if folder is None else _of_folder(folder)


@cache
def _built_in(name: str) -> RobotSpec:
    from nw_scenes.robots.derived import spec_of
    from nw_scenes.robots.folder import read_folder

    return spec_of(read_folder(_SHIPPED / name))


def _of_folder(folder: Path, *, is_known: bool = True) -> FoundRobot:
    """Return the robot of a folder; it is read again where a file of it has changed.

    Args:
        folder: with a robot.yaml.
        is_known: whether its name means this folder from now on.
    """
    folder = folder.resolve()
    if folder.parent == _SHIPPED:
        return _named(folder.name)
    before = _read.get(folder)
    if before is None or _stamps(folder, before.files) != before.stamps:
        # The library of meshes and MuJoCo's compiler are for folders alone.
        from nw_scenes.robots.folder import read_folder
        from nw_scenes.robots.kept import kept_spec

        read = read_folder(folder)
        if read.settings.name in BUILT_IN:
            message = f"name: {read.settings.name!r} is built in"
            raise RobotError([read.file.problem(("name",), message, "give another name")])
        stamps = _stamps(folder, read.files)
        identity = read.digest[:_DIGITS]
        spec, notes = kept_spec(read)
        robot = FoundRobot(spec=spec, identity=identity, folder=folder, notes=notes)
        before = _read[folder] = _Read(robot, read.files, stamps)
    if is_known:
        _folders[before.robot.spec.name] = folder
    return before.robot


def files_of(robot: FoundRobot) -> tuple[str, ...]:
    """Return the names of the files that a robot was read from here; none if it is built in."""
    return () if robot.folder is None else _read[robot.folder].files


def _fetched_folder(reference: str) -> Path:
    """Return the folder of a robot of a hub or of MuJoCo Menagerie, fetched if it is not here."""
    from nw_scenes.hub.fetch import located

    fetched = located(parse(reference, "robot"))
    if not (fetched.folder / "robot.yaml").is_file():
        raise RobotError(
            f"{reference}: its revision {fetched.revision[:12]} has no robot.yaml",
            fix="name a repository that is a robot's folder",
        )
    return fetched.folder


def _of_fetched(reference: str) -> FoundRobot:
    """Return the robot of such a folder; of Menagerie's, errors say where one writes what lacks."""
    folder = _fetched_folder(reference)
    try:
        return _of_folder(folder)
    except RobotError as error:
        if not reference.startswith(MENAGERIE):
            raise
        own = f"{_FOLDER}/{folder.name}"
        copied = f"copy {folder} to {own} and name that; in its robot.yaml, "
        raise RobotError(
            [replace(each, fix=copied + (each.fix or "fix it")) for each in error.problems]
        ) from None


class _Read(NamedTuple):
    """A folder that was read in this process."""

    robot: FoundRobot
    files: tuple[str, ...]
    stamps: tuple[tuple[int, int], ...]


_read: dict[Path, _Read] = {}


def _stamps(folder: Path, files: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Return when files were written last, ns, and their sizes; nothing where one is gone."""
    try:
        facts = [(folder / name).stat() for name in files]
    except OSError:
        return ()
    return tuple((each.st_mtime_ns, each.st_size) for each in facts)


@cache
def _of_package(name: str) -> FoundRobot:
    """Return the robot of an installed package.

    Its entry point names a function that returns a `RobotSpec`, or the path of a robot's folder.
    """
    whose = subject(installed(ROBOTS)[name][0])
    try:
        value = imported(ROBOTS, name)
        made = value() if callable(value) else value
        robot = made if isinstance(made, RobotSpec) else _of_folder(Path(str(made)), is_known=False)
    except UsageError:
        raise
    except PluginError as error:  # The error of robots, which is told beside a suite's others.
        raise RobotError(error.message, fix=error.fix) from error
    except Exception as error:
        raise RobotError(
            f"{whose} cannot be used: {type(error).__name__}: {error}",
            fix="fix or uninstall that package",
        ) from error
    spec = robot if isinstance(robot, RobotSpec) else robot.spec
    if spec.name != name:
        raise RobotError(f"{whose} is the robot {spec.name!r}", fix="give both the same name")
    package, version, *code = identity_of(ROBOTS, name).split()
    identity = "-".join((package, version, *(each[:_DIGITS] for each in code)))
    if not isinstance(robot, RobotSpec):
        identity += f"-{robot.identity}"
    return FoundRobot(spec=spec, identity=identity)
