"""Trainings whose settings and observations stand in Python files: read, never run.

legged_gym and its forks (humanoid-gym, HIMLoco, trainings of EngineAI and of Unitree) register each
task with a class of settings and one of the environment, whose `compute_observations` joins what
the policy sees. Of the settings the constants are read, with those of the classes below; of the
method the terms (`training_terms`). What is computed otherwise stays unknown.

Environments of Isaac Lab that compute observations in code are read alike: those of legged_lab and
its forks (TienKung) are registered as above, direct ones name their settings as the type of `cfg`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import PurePosixPath
from typing import Any, cast

from nw_policies.cards.joints import short_name
from nw_policies.drafting.constants import UNKNOWN, constant, follow_settings
from nw_policies.drafting.environments import read_direct_environment, speeds_of
from nw_policies.drafting.exporters import ExporterMetadata
from nw_policies.drafting.fields import Fields, number_of
from nw_policies.drafting.gym_training import is_gym_training, read_gym_training
from nw_policies.drafting.notation import plain
from nw_policies.drafting.training_terms import OBSERVES, Environment, seen_terms
from nw_scenes.robots import RobotSpec

_DEEPEST = 12
"""Classes below a class."""
_OTHERS = 6
"""Tasks that fit as well and are named."""


@dataclass(frozen=True, kw_only=True)
class _Task:
    """A registered training."""

    name: str
    file: str
    """Which registers it, or has the direct environment."""
    settings: str
    """Name of the class."""
    environment: str
    trainer: str


class _Outer(Mapping[str, Any]):
    """What names mean in a module: settings of classes, and constants, of its own file first."""

    def __init__(self, classes: CodeClasses, file: str) -> None:
        self._classes, self._file = classes, file
        self._known: dict[str, Any] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._classes.found or name in self._classes.assigned

    def __getitem__(self, name: str) -> Any:
        if name not in self:
            raise KeyError(name)
        if name not in self._known:
            self._known[name] = UNKNOWN  # Of what is defined by itself.
            if name in self._classes.found:
                self._known[name] = self._classes.settings(name, self._file)
            else:
                values = self._classes.assigned[name]
                own = min(values, key=partial(self._classes.unlike, name, self._file))
                self._known[name] = constant(values[own], self._classes.outer(own))
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self._classes.found, **self._classes.assigned})

    def __len__(self) -> int:
        return len({**self._classes.found, **self._classes.assigned})


class CodeClasses:
    """Classes of several files by name; of those that are called alike, what a file imports."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self.found: dict[str, list[tuple[str, ast.ClassDef]]] = {}
        self.tasks: list[_Task] = []
        self.assigned: dict[str, dict[str, ast.expr]] = {}
        """Values of names of modules, by file."""
        self._outer: dict[str, _Outer] = {}
        self._imported: dict[tuple[str, str], str] = {}
        self._known: dict[tuple[str, str], dict[str, Any]] = {}
        for file, text in texts.items():
            try:
                tree = ast.parse(text.removeprefix("\ufeff"))
            except (SyntaxError, ValueError):
                continue
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    self.found.setdefault(node.name, []).append((file, node))
                    self.tasks += _direct(node, file)
                elif isinstance(node, ast.ImportFrom):
                    self._imported |= {(file, name.name): node.module or "" for name in node.names}
                elif isinstance(node, ast.Call):
                    self.tasks += _task(node, file)
            for line in tree.body:
                if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
                    self.assigned.setdefault(line.targets[0].id, {})[file] = line.value

    def outer(self, file: str) -> _Outer:
        """Return what names mean in a module."""
        return self._outer.setdefault(file, _Outer(self, file))

    def unlike(self, name: str, file: str, other: str) -> tuple[bool, bool, bool]:
        """Return how unlike another file is to be that which a file has a name of."""
        module = self._imported.get((file, name), "").rpartition(".")[2]
        place = PurePosixPath(other)
        return other != file, place.stem != module, place.parent != PurePosixPath(file).parent

    def of(self, name: str, file: str = "") -> tuple[str, ast.ClassDef] | None:
        """Return the file of a class, and the class: of the own file, or as the file imports it."""
        found = self.found.get(name, [])
        return min(found, key=lambda pair: self.unlike(name, file, pair[0]), default=None)

    def settings(self, name: str, file: str = "", depth: int = 0) -> dict[str, Any]:
        """Return the constants of a class and of those below it; of inner classes, mappings."""
        found = self.of(name, file)
        if found is None or depth > _DEEPEST:
            return {}
        place = name, found[0]
        if place not in self._known:
            self._known[place] = {}  # Of a class that inherits from itself.
            self._known[place] = self._inner(found[1], found[0], depth)
        return self._known[place]

    def _inner(self, node: ast.ClassDef, file: str, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for base in reversed(node.bases):  # The first one counts most.
            root, *path = _dotted(base)
            if path and self.of(root, file) is None:  # A module's.
                root, path = path[-1], []
            inherited: Any = self.settings(root, file, depth + 1) if root != node.name else {}
            for part in path:
                inherited = inherited.get(part, {}) if isinstance(inherited, dict) else {}
            values |= cast("dict[str, Any]", inherited) if isinstance(inherited, dict) else {}
        for line in node.body:
            if isinstance(line, ast.ClassDef):
                values[line.name] = self._inner(line, file, depth + 1)
            else:
                follow_settings(line, values, self.outer(file))
        return values

    def methods(self, name: str, file: str = "") -> list[Mapping[str, ast.FunctionDef]]:
        """Return the methods of a class, and of each that it inherits from, nearest first."""
        nearest: list[ast.ClassDef] = []
        seen: set[int] = set()

        def visit(name: str, file: str, depth: int) -> None:
            found = self.of(name, file)
            if found is None or id(found[1]) in seen or depth > _DEEPEST:
                return
            seen.add(id(found[1]))
            for base in reversed(found[1].bases):
                visit(_dotted(base)[-1], found[0], depth + 1)
            nearest.insert(0, found[1])

        visit(name, file, 0)
        return [
            {line.name: line for line in node.body if isinstance(line, ast.FunctionDef)}
            for node in nearest
        ]


def _dotted(node: ast.expr) -> list[str]:
    """Return `a.b.c` as its parts; one empty part of anything else."""
    if isinstance(node, ast.Attribute):
        return [*_dotted(node.value), node.attr]
    return [node.id if isinstance(node, ast.Name) else ""]


def _task(node: ast.Call, file: str) -> Iterator[_Task]:
    """Give the task of a call `task_registry.register("name", Environment, Settings(), ...)`."""
    if _dotted(node.func)[-1] != "register" or len(node.args) < 3:
        return
    name, *classes = node.args
    called = [each.func if isinstance(each, ast.Call) else each for each in classes]
    if isinstance(name, ast.Constant) and isinstance(name.value, str):
        names = [_dotted(each)[-1] for each in called]
        yield _Task(
            name=name.value,
            file=file,
            environment=names[0],
            settings=names[1],
            trainer=names[2] if len(names) > 2 else "",
        )


def _direct(node: ast.ClassDef, file: str) -> Iterator[_Task]:
    """Give a task for each class of settings that a direct environment may have as its `cfg`."""
    methods = [line.name for line in node.body if isinstance(line, ast.FunctionDef)]
    if OBSERVES[1] not in methods:
        return
    types = [
        name.id
        for line in node.body
        if isinstance(line, ast.AnnAssign) and _dotted(line.target) == ["cfg"]
        for name in ast.walk(line.annotation)
        if isinstance(name, ast.Name)
    ]
    for name in types or [""]:
        yield _Task(
            name=name or node.name, file=file, environment=node.name, settings=name, trainer=""
        )


def read_training_code(
    texts: Mapping[str, str],
    robot: RobotSpec,
    checkpoint: str,
    size: int,
    saved: Mapping[str, Any] | None = None,
) -> ExporterMetadata | None:
    """Return what the code of a training says of a checkpoint; None where no task fits it.

    Args:
        texts: name and text of its files, below a folder `envs`.
        robot: that the policy drives; a task of other joints does not fit.
        checkpoint: its path, by whose names one of several tasks is taken.
        size: numbers that it takes; 0 where it does not say.
        saved: settings that were saved with the checkpoint, which count before those of the code.
    """
    try:
        classes = CodeClasses(texts)
        fits = [
            (_likeness(task, classes, robot, f"{checkpoint} {_experiment(saved)}"), each)
            for task in classes.tasks
            if (each := _read(task, classes, robot, size, saved)) is not None
        ]
    except (RecursionError, MemoryError):
        return ExporterMetadata(
            notes=("the code of the training is nested too deep, or too large, to be read",)
        )
    if not fits:
        return None
    best = max(score for score, _ in fits)
    named = [(task, said) for score, (task, said) in fits if score == best]
    task, said = named[0]
    others = [other.name for other, theirs in named[1:] if theirs != said]
    file = (classes.of(task.environment, task.file) or ("",))[0]
    note = (
        f"its terms and settings are those of the task {task.name} in {plain(file)}, whose code "
        "was read, not run: is that its training?"
    )
    if others:
        note += f" {', '.join(others[:_OTHERS])} would fit as well"
    marked = {field.name: plain(file) for field in fields(said) if getattr(said, field.name)}
    return replace(said, notes=(plain(note), *said.notes), sources=marked)


def _likeness(task: _Task, classes: CodeClasses, robot: RobotSpec, path: str) -> tuple[int, bool]:
    """Return how well the names of a task are those of a checkpoint's path and of its robot."""
    names = [_letters(task.name), _letters(_experiment(classes.settings(task.trainer, task.file)))]
    lengths = [len(name) for name in names if name and name in _letters(path)]
    asset = classes.settings(task.settings, task.file).get("asset")
    own = str(asset.get("name")) if isinstance(asset, dict) else ""
    return max(lengths, default=0), _letters(own) == _letters(robot.name)


def _experiment(settings: Mapping[str, Any] | None) -> str:
    runner = (settings or {}).get("runner")
    return str(runner.get("experiment_name") or "") if isinstance(runner, dict) else ""


def _letters(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _read(
    task: _Task, classes: CodeClasses, robot: RobotSpec, size: int, saved: Mapping[str, Any] | None
) -> tuple[_Task, ExporterMetadata] | None:
    """Return what a task says of a robot's policy; None where it is of another, or not read."""
    settings = {**classes.settings(task.settings, task.file), **(saved or {})}
    config = Fields(settings)
    methods = classes.methods(task.environment, task.file)
    if not any(name in own for own in methods for name in OBSERVES):
        return None
    if (lab := _lab_environment(config)) is not None:
        return _read_lab(task, lab, methods, robot, size, settings)
    if not is_gym_training(config):
        return None
    joints = len(robot.joints)
    pose = {short_name(name) for name in config.below("init_state").below("default_joint_angles")}
    actions = config.below("env").number("num_actions")
    if actions not in {None, joints} or not pose >= set(map(short_name, robot.joints)):
        return None
    terms = seen_terms(Environment(settings=settings, methods=methods, joints=joints)).terms
    total = sum((term.width or 0) * (term.history or 1) for term in terms)
    if size not in {0, total or config.below("env").number("num_observations")}:
        return None
    said = read_gym_training(config, robot, ())
    # Without terms its note stands, that the code alone has them.
    return task, replace(said, observation_terms=terms, notes=() if terms else said.notes)


def _lab_environment(config: Fields) -> Fields | None:
    """Return settings of Isaac Lab as a direct environment has them; None of another training.

    legged_lab has the robot in its scene, and the decimation beside the time step.
    """
    asset = config.below("scene").get("robot")
    asset = config.get("robot") if not isinstance(asset, Fields) else asset
    own, sim = config.below("robot"), config.below("sim")
    every = config.get("decimation") or sim.get("decimation")
    if sim.number("dt") is None or number_of(every) is None:
        return None
    scale = config.get("action_scale") or own.get("action_scale")
    return Fields(
        {
            **config,
            "sim": {"dt": sim.number("dt")},
            "decimation": every,
            "robot": asset if isinstance(asset, Fields) else {},
            "action_scale": scale,
        }
    )


def _read_lab(
    task: _Task,
    config: Fields,
    methods: Sequence[Mapping[str, ast.FunctionDef]],
    robot: RobotSpec,
    size: int,
    settings: Mapping[str, Any],
) -> tuple[_Task, ExporterMetadata] | None:
    """Return what a task of Isaac Lab says of a robot's policy; None where it is of another."""
    joints, actions = len(robot.joints), config.number("action_space", "num_actions")
    said = read_direct_environment(config, robot, ())
    has_asset = bool(said.joint_stiffness and said.default_joint_pos)
    if actions not in {None, joints} or (actions is None and not has_asset):
        return None
    seen = seen_terms(
        Environment(settings=settings, methods=methods, joints=joints, is_lab=True, size=size)
    )
    total = sum((term.width or 0) * (term.history or 1) for term in seen.terms)
    if size not in {0, total or config.number("observation_space") or size}:
        return None
    normal = config.below("normalization")
    clip = seen.clip or normal.number("clip_actions")
    return task, replace(
        said,
        joint_names=said.joint_names if has_asset else (),
        observation_terms=seen.terms,
        observation_clip=normal.number("clip_observations"),
        action_clip=(-clip, clip) if clip else None,
        speeds=speeds_of(Fields({"": config.get("commands")})),
        notes=(*seen.notes, *(() if seen.terms else said.notes)),
    )


def settings_of(texts: Sequence[Fields]) -> Mapping[str, Any] | None:
    """Return the settings of a training that were saved as a file; None where there are none."""
    return next(
        (
            data
            for data in texts
            if ("env" in data and is_gym_training(Fields(data)))
            or {"sim", "decimation", "robot", "observation_space"} <= set(data)
        ),
        None,
    )
