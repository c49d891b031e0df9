"""What files beside a checkpoint say of it: what exporters and trainings write, read as data.

`configs` reads each kind of file; here the files are found, and what they say is merged. Lists for
each joint are in the order of `joint_names`, whatever their order in the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import cycle
from pathlib import Path
from typing import Any

from nw_base.errors import PolicyError
from nw_base.files.inside import bounded_bytes, what_is
from nw_base.files.yaml_file import YamlProblems, parse_yaml
from nw_base.plural import plural
from nw_policies.cards.joints import short_name
from nw_policies.drafting.checkpoint import CheckpointFacts
from nw_policies.drafting.configs import reader_of
from nw_policies.drafting.deploy_script import read_deploy_script
from nw_policies.drafting.environments import IN_CODE as OF_LAB
from nw_policies.drafting.exporters import ExporterMetadata
from nw_policies.drafting.fields import Fields, account
from nw_policies.drafting.gym_training import IN_CODE, pickled_settings
from nw_policies.drafting.leapp import pipeline_checkpoint
from nw_policies.drafting.notation import plain
from nw_policies.drafting.patterns import reordered
from nw_policies.drafting.training_code import read_training_code, settings_of
from nw_policies.drafting.vectors import sized_terms
from nw_policies.folding import newest_orbax
from nw_scenes.robots import RobotSpec

_LARGEST = 2**20
"""Bytes of a file; Isaac Lab's env.yaml has some 50 kB."""
_MOST = 24
"""Files that are looked at."""
_MOST_CODE = 120
"""Files of a training's code."""
_MOST_DIRECT = 500
"""Files of tasks of Isaac Lab among which direct environments are looked for."""
_HIGHEST = 8
"""Folders from a checkpoint up in which such code is looked for."""
_OF_ROOT = (".git", "setup.py", "pyproject.toml")
"""What the top of a repository has."""
_PICKLES = ("parameters.pkl", "../parameters.pkl")
"""Where walk-these-ways and its forks keep their settings."""
_FOLDERS = (".", "params", "io_descriptors", "config", "configs")
_ABOVE = (".", "params", "io_descriptors", "config", "configs")
_PRETRAINED = frozenset({"pre_train", "pretrain", "pretrained"})
"""Of checkpoints beside deploy scripts, as in unitree_rl_gym: `pre_train/ROBOT/motion.pt`."""
_OF_DEPLOY_TREE = tuple(
    f"{scripts}{configs}"
    for scripts in ("", "deploy_real/", "deploy_real/*/", "deploy_mujoco/", "deploy_mujoco/*/")
    for configs in ("config", "configs")
)
"""Where the scripts' settings lie, beside such a folder."""
_SUFFIXES = frozenset(
    {".onnx", ".pt", ".pt2", ".pth", ".jit", ".safetensors", ".zip", ".msgpack", ".cleanrl_model"}
)
_PER_JOINT = (
    "joint_stiffness",
    "joint_damping",
    "default_joint_pos",
    "action_scale",
    "torque_limits",
    "armature",
    "friction_loss",
    "viscous_friction",
)
_MAY_BE_ZERO = frozenset({"armature", "friction_loss", "viscous_friction"})
_ORDER = (
    "deploy", "io_descriptors", "legged_rl_deploy", "legged_ros2", "rl_sar", "gym", "muwanx",
    "booster", "limx", "humanoidverse_deploy", "checkpoint",
    "env", "humanoidverse_train", "gym_training", "training_code", "agent",
)  # fmt: skip
"""Which kind of file is believed before others."""


def files_beside_checkpoint(checkpoint: Path, robot: str = "") -> dict[str, str]:
    """Return the YAML and JSON files that may say something of a checkpoint: name and text.

    They lie beside it, in `params` or `io_descriptors` there, in the folder above or in such
    folders of that, as in Isaac Lab, where policies are exported to `exported/`. In unitree_rl_gym
    and its forks they lie in the folders of its deploy scripts; of those only the robot's are
    meant, by their names or by the folder of the checkpoint. JSON is called as the checkpoint is.
    """
    folder = checkpoint.parent
    own = [f"{checkpoint.stem}.json", "asset_meta.json", "config.json", *_PICKLES]
    files = [(name, folder / name) for name in own if (folder / name).exists()]
    for name in _FOLDERS:
        files += _yaml_files(folder / name, "" if name == "." else f"{name}/")
    above = folder.absolute().parent
    for name in _ABOVE:
        files += _yaml_files(above / name, "../" if name == "." else f"../{name}/")
    for up, place in enumerate((folder.absolute(), above), start=1):
        if place.name in _PRETRAINED:
            named = [folder.absolute().name] if up == 2 else [robot]
            files += _deployed(place.parent, "../" * up, named)
    listed = _texts([(name, path) for name, path in files if name != "policy.yaml"], _MOST)
    return listed | _texts(_code(checkpoint), _MOST_CODE)


def _texts(files: Sequence[tuple[str, Path]], most: int) -> dict[str, str]:
    texts: dict[str, str] = {}
    for name, path in files:
        try:
            if len(texts) < most:
                # Bytes of a pickle are kept as letters of the same numbers.
                letters = "latin-1" if name in _PICKLES else "utf-8"
                texts[name] = bounded_bytes(path, _LARGEST).decode(letters)
        except (OSError, ValueError):
            continue
    return texts


def _text(path: Path) -> str:
    """Return the text of a file; nothing of one that is too large, or no text."""
    return _texts([("", path)], 1).get("", "")


def _code(checkpoint: Path) -> list[tuple[str, Path]]:
    """Return the files of a training's code, of the repository that a checkpoint lies in.

    Tasks are registered in `envs/__init__.py`, in or below a folder above the checkpoint, with
    robots in `assets` beside it; direct ones of Isaac Lab lie below `source/NAME/NAME/tasks`. Else
    it is the scripts that name the checkpoint, at most one folder deep. What lies outside of the
    repository is not looked at: it is of other policies.
    """
    places = list(checkpoint.absolute().parents)[:_HIGHEST]
    ends = [up for up, place in enumerate(places) if any((place / n).exists() for n in _OF_ROOT)]
    for up, place in enumerate(places[: ends[0] + 1] if ends else ()):
        for envs in (place / "envs", *sorted(place.glob("*/envs"))):
            if ".register(" in _text(envs / "__init__.py"):
                files = [*sorted(envs.rglob("*.py")), *sorted(envs.parent.glob("assets/**/*.py"))]
                return _named(files, place, up)
        direct = sorted(place.glob("source/*/*/tasks/**/*.py"))[:_MOST_DIRECT]
        if any("def _get_observations" in _text(path) for path in direct):
            return _named(direct, place, up)
    for up, place in enumerate(places[: ends[0] + 1] if ends else ()):
        scripts = [*sorted(place.glob("*.py")), *sorted(place.glob("*/*.py"))][:_MOST_DIRECT]
        found = [path for path in scripts if _names(path, checkpoint)]
        if found:
            return _named(found, place, up)
    return []


def _names(script: Path, checkpoint: Path) -> bool:
    """Return whether a script speaks of a checkpoint and fills slices of a row."""
    text = _text(script)
    return checkpoint.name in text and ":" in text and "obs" in text


def _named(files: Sequence[Path], place: Path, up: int) -> list[tuple[str, Path]]:
    return [(f"{'../' * up}{path.relative_to(place).as_posix()}", path) for path in files]


def _deployed(root: Path, prefix: str, named: Sequence[str]) -> list[tuple[str, Path]]:
    """Return files of deploy scripts that begin with one of some names, or lie in its folder."""
    files: list[tuple[str, Path]] = []
    for pattern in _OF_DEPLOY_TREE:
        for folder in sorted(root.glob(pattern)):
            inner = folder.relative_to(root)
            of_folder = len(inner.parts) > 2 and inner.parts[1] in named
            files += [
                pair
                for pair in _yaml_files(folder, f"{prefix}{inner.as_posix()}/")
                if of_folder or any(pair[1].stem.startswith(name) for name in named)
            ]
    return files


def _yaml_files(folder: Path, prefix: str) -> list[tuple[str, Path]]:
    return [
        (f"{prefix}{path.name}", path)
        for path in sorted(folder.glob("*.y*ml"))
        if path.suffix in {".yaml", ".yml"}
    ]


def find_checkpoint(folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Return the newest checkpoint in a folder of a training, and the names of the others.

    The highest step is the newest (`model_1500.pt`, `agent_16000.pt`); without steps, the one
    called best; else what was exported. Of a pipeline of LEAPP it is the file that gives the
    action.

    Raises:
        PolicyError: there is none, or the pipeline cannot be used.
    """
    if (node := pipeline_checkpoint(folder)) is not None:
        return node, ()
    checkpoints = [
        path
        for pattern in ("*", "*/*")
        for path in sorted(folder.glob(pattern))
        if (path.suffix in _SUFFIXES or path.name == "params") and what_is(path) == "file"
    ]
    if checkpoints and all(path.parent != folder for path in checkpoints):
        for place in dict.fromkeys(path.parent for path in checkpoints):
            if (node := pipeline_checkpoint(place)) is not None:
                return node, ()
    if not checkpoints and (step := newest_orbax(folder)) is not None:
        raise PolicyError(
            f"{step}: this is a checkpoint of Orbax, a folder of files",
            fix=f"write it as one file, and draft the card of that: `nw-eval policies fold {step} "
            "--out policy.safetensors`",
        )
    if not checkpoints:
        raise PolicyError(
            f"{folder}: no checkpoint is in it or in its folders",
            fix=f"name the file; checkpoints end in {', '.join(sorted(_SUFFIXES))}",
        )

    def rank(path: Path) -> tuple[int, bool, bool, str]:
        step = re.search(r"(\d+)$", path.stem)
        best = "best" in path.stem
        return int(step[1]) if step else -1, best, path.suffix == ".onnx", path.name

    newest = max(checkpoints, key=rank)
    others = [str(path.relative_to(folder)) for path in checkpoints if path != newest]
    return newest, tuple(others)


def read_beside(
    texts: Mapping[str, str],
    robot: RobotSpec,
    checkpoint: str = "",
    own: ExporterMetadata | None = None,
    size: int = 0,
) -> ExporterMetadata | None:
    """Return what files say together; None where none is of a known kind.

    Args:
        texts: name and text of each, as `files_beside_checkpoint` gives them.
        robot: whose joints patterns and motors' numbers mean.
        checkpoint: the path of the file that they are about; files that name another are left out.
        own: what the checkpoint says itself.
        size: numbers that it takes; 0 where it does not say.
    """
    read = _read_files(texts, robot, checkpoint, size)
    if own is not None:
        read.append((_ORDER.index("checkpoint"), own))
    if not read:
        return None
    read.sort(key=lambda pair: pair[0])
    whole = read[0][1]
    for _, other in read[1:]:
        whole = merged(whole, other)
    return whole


def _read_files(
    texts: Mapping[str, str], robot: RobotSpec, checkpoint: str, size: int
) -> list[tuple[int, ExporterMetadata]]:
    """Return what each file says that is about a checkpoint, and the index of its kind."""
    code = {name: text for name, text in texts.items() if name.endswith(".py")}
    read, saved = _read_settings(
        {name: text for name, text in texts.items() if name not in code}, robot, checkpoint, size
    )
    said = read_training_code(code, robot, checkpoint, size, saved) if code else None
    if said is not None:
        return _with_code(read, said)
    script = None if read else read_deploy_script(code, robot, checkpoint, size)
    return read if script is None else [(_ORDER.index("gym"), script)]


def _read_settings(
    texts: Mapping[str, str], robot: RobotSpec, checkpoint: str, size: int
) -> tuple[list[tuple[int, ExporterMetadata]], Mapping[str, Any] | None]:
    """Return what YAML and JSON files say, and the saved settings of a training in Isaac Gym."""
    parsed, left = _parsed(texts)
    by_kind: dict[str, list[tuple[str, ExporterMetadata]]] = {}
    for name, data in parsed.items():
        kind, reader = reader_of(Fields(data))  # Of a copy: to look is not to read.
        said = ExporterMetadata()
        if reader is not None:
            said = reader(data, robot, list(parsed.values()))
        if said != ExporterMetadata():
            marked = {f.name: plain(name) for f in fields(said) if getattr(said, f.name)}
            by_kind.setdefault(kind, []).append((name, replace(said, sources=marked)))
        elif not name.startswith("../") and not any(key.startswith("nw-") for key in data):
            left[name] = f"its keys are {', '.join(data)[:200]}" if data else ""
    notes: list[str] = []
    for name, why in left.items():
        if name in parsed and parsed[name].is_read:  # By the reader of another file.
            notes += account(plain(name), by_kind, parsed[name])
        elif why:
            notes.append(f"{plain(name)} was not read: {plain(why)}")
    read = [*_by_belief(by_kind, parsed, robot, checkpoint, size), *_noted(notes)]
    return read, settings_of(list(parsed.values()))


def _parsed(texts: Mapping[str, str]) -> tuple[dict[str, Fields], dict[str, str]]:
    """Return the fields of each file, and why the others have none."""
    parsed: dict[str, Fields] = {}
    left: dict[str, str] = {}
    for name, text in texts.items():
        try:
            if name in _PICKLES:
                parsed[name] = pickled_settings(text.encode("latin-1"), name)
            else:
                parsed[name] = Fields(parse_yaml(text, file=name, foreign=True).data)
        except PolicyError as error:
            left[name] = error.message
        except YamlProblems as problems:
            left[name] = str(problems.problems[0].message) if text.strip() else ""
    return parsed, left


def _with_code(
    read: Sequence[tuple[int, ExporterMetadata]], code: ExporterMetadata
) -> list[tuple[int, ExporterMetadata]]:
    """Return what files say with the terms of a training's code, which a deploy config lacks."""
    guessed = _ORDER.index("gym")
    if code.observation_terms and all(term.own or term.grid for term in code.observation_terms):
        read = [
            (
                kind,
                replace(
                    said,
                    observation_terms=() if kind == guessed else said.observation_terms,
                    notes=tuple(note for note in said.notes if note not in {IN_CODE, OF_LAB}),
                ),
            )
            for kind, said in read
        ]
    return [*read, (_ORDER.index("training_code"), code)]


def _noted(notes: Sequence[str]) -> list[tuple[int, ExporterMetadata]]:
    return [(len(_ORDER), ExporterMetadata(notes=tuple(notes)))] if notes else []


def _by_belief(
    by_kind: Mapping[str, list[tuple[str, ExporterMetadata]]],
    parsed: Mapping[str, Fields],
    robot: RobotSpec,
    checkpoint: str,
    size: int,
) -> list[tuple[int, ExporterMetadata]]:
    """Return what the files say that are about a checkpoint, with notes of what they leave."""
    read: list[tuple[int, ExporterMetadata]] = []
    others: list[str] = []
    for kind, several in by_kind.items():
        about = _about(several, checkpoint, len(robot.joints), size)
        others += [plain(name) for name, _ in several if name not in dict(about)]
        for name, said in _of_one_script(about) if kind == "gym" else about:
            notes = (*said.notes, *account(plain(name), [kind], parsed[name]))
            if said.model and Path(said.model).stem != Path(checkpoint).stem:
                other = plain(Path(said.model).name)
                notes = (*notes, f"{plain(name)} is about {other}: is that this file?")
            read.append((_ORDER.index(kind), replace(said, notes=notes)))
    about = f"not read, of another policy by names or sizes: {', '.join(others)}"
    return [*read, *_noted([about] if others else [])]


def _of_one_script(
    several: Sequence[tuple[str, ExporterMetadata]],
) -> list[tuple[str, ExporterMetadata]]:
    """Return that of several deploy configs which names the order of joints, else the first.

    Scripts of one policy say the same in other orders, or are of other policies of its size.
    """
    if len(several) < 2:
        return list(several)
    (name, said), *others = sorted(several, key=lambda pair: pair[1].guessed_order)
    left = ", ".join(plain(other) for other, _ in others)
    note = f"{plain(name)} was taken; so many numbers are in {left}, too"
    return [(name, replace(said, notes=(*said.notes, note)))]


def _about(
    several: Sequence[tuple[str, ExporterMetadata]], checkpoint: str, joints: int, size: int
) -> list[tuple[str, ExporterMetadata]]:
    """Return those files of one kind that are about a checkpoint; all of them where nothing tells.

    A folder may hold a file for each of several policies.
    """

    def unlikeness(said: ExporterMetadata) -> tuple[bool, bool, bool]:
        terms = sized_terms(said.observation_terms, joints)
        total = sum((term.width or 0) * (term.history or 1) for term in terms)
        is_other = bool(said.model) and Path(said.model).stem != Path(checkpoint).stem
        return said.joint_count not in {0, joints}, is_other, bool(terms) and size not in {0, total}

    # A policy of another size is another policy: its gains and pose say nothing of this one.
    fits = [pair for pair in several if not (pair[1].input_size and size % pair[1].input_size)]
    best = min((unlikeness(said) for _, said in fits), default=None)
    alike = [(name, said) for name, said in fits if unlikeness(said) == best]
    # Copies and drafts of a deploy.yaml lie beside it.
    exported = [pair for pair in alike if f"/{pair[0]}".endswith("/params/deploy.yaml")]
    return exported or alike


def merged(one: ExporterMetadata, other: ExporterMetadata) -> ExporterMetadata:
    """Return what two files say together; where both say something, the first is believed."""
    names = one.joint_names or other.joint_names
    taken: dict[str, Any] = {}
    notes: list[str] = []
    sources = dict(one.sources)
    for field in fields(one):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if mine and theirs and field.name in _PER_JOINT:
            same = reordered(theirs, other.joint_names or names, names)
            if same and _differ(mine, same):
                sides = [x.sources.get(field.name, "the checkpoint") for x in (one, other)]
                notes.append(f"{field.name} differs in {' and '.join(sides)}: the first is used")
        is_apart = field.name in {"sources", "notes", "guessed_order"}
        if is_apart or mine or not theirs:
            continue
        if field.name in _PER_JOINT:
            theirs = reordered(theirs, other.joint_names or names, names)
            if not theirs:
                where = other.sources.get(field.name, "the checkpoint")
                notes.append(f"{field.name} of {where} is of other joints, and is not used")
                continue
        taken[field.name] = theirs
        if field.name in other.sources:
            sources[field.name] = other.sources[field.name]
    notes = [*dict.fromkeys((*one.notes, *other.notes, *notes))]
    is_guess = one.guessed_order if one.joint_names else other.guessed_order
    return replace(one, **taken, sources=sources, notes=tuple(notes), guessed_order=is_guess)


def _differ(one: Sequence[float], other: Sequence[float]) -> bool:
    """Whether numbers of joints differ by more than three decimals round."""
    pairs = zip(cycle(one), cycle(other), range(max(len(one), len(other))), strict=False)
    return any(abs(a - b) > 1e-3 + 2e-3 * abs(a) for a, b, _ in pairs)


_WEAK = 0.1
"""Share of the largest torque that a radian gives at least, with any gains that carry a robot."""
_ROUNDED = 0.02
"""Below it three decimals are off by 2.5 % and more."""


def believed(known: ExporterMetadata, robot: RobotSpec) -> ExporterMetadata:
    """Return what files say without numbers that cannot be a robot's, each named in a note."""
    notes, dropped = [*known.notes], dict[str, Any]()
    for name in _PER_JOINT:
        values: tuple[float, ...] = getattr(known, name)
        source = known.sources.get(name, "its metadata")
        if values and (reason := _doubt(name, values, known.action, robot)):
            dropped[name] = ()
            notes.append(f"{name} of {source} {reason}, and is not used")
        elif name not in known.sources and any(0 < abs(v) < _ROUNDED for v in values):
            small = min(abs(value) for value in values if value)
            notes.append(f"{name} of {source} has {small:g}, which three decimals round by far")
    dead = [term.name for term in known.observation_terms if term.scale and 0.0 in term.scale]
    if dead:
        notes.append(f"the scale of {', '.join(map(plain, dead))} is 0: the policy is blind to it")
    return replace(known, **dropped, notes=tuple(dict.fromkeys(notes)))


def _doubt(name: str, values: Sequence[float], action: str, robot: RobotSpec) -> str:
    """Return why numbers of joints cannot be a robot's; empty where they can."""
    joints, follows = len(robot.joints), action not in {"joint_torque", "joint_velocity"}
    if len(values) not in {1, joints}:
        return f"has {plural(len(values), 'number')} for {joints} joints"
    if not all(map(math.isfinite, values)):
        return "is not finite"
    if name == "default_joint_pos":
        return ""
    if not any(values) and name not in _MAY_BE_ZERO and (follows or name == "torque_limits"):
        return "is 0 for all joints"
    if min(values) < 0 and name != "action_scale":
        return f"is {min(values):g}, below 0"
    if name == "joint_stiffness" and follows and max(values) < _WEAK * max(robot.torque_limits):
        return f"is {max(values):g} N m/rad at most, too weak to carry the {robot.name}"
    return ""


_LOOKS: tuple[tuple[str, str], ...] = (
    (r"LF_HAA", "ANYmal"),
    (r"fl[._]hx", "Boston Dynamics' Spot"),
    (r"(?=.*RL_).*(FR_foot|FR_wheel)", "a quadruped on wheels, such as Go2-W or B2-W"),
    (r"FL_HipX", "Lite3 of DeepRobotics"),
    (r"waist_yaw|waist_roll", "a humanoid, such as Unitree's G1"),
    (r"left_ankle_(pitch|roll)", "a humanoid, such as Unitree's G1 or H1-2"),
    (r"left_hip_yaw", "a biped, such as Unitree's H1"),
    (r"(?=.*RL_).*FR_hip", "a quadruped of Unitree: A1, Go1, Go2, B2"),
)
"""By a name among the joints, whose they are."""


def refuse_another_robot(
    facts: CheckpointFacts, known: ExporterMetadata | None, robot: RobotSpec
) -> None:
    """Refuse a checkpoint whose joints, or whose number of actions, are another robot's.

    Raises:
        PolicyError: they are.
    """
    own = {short_name(joint) for joint in robot.joints}
    names = [short_name(name) for name in (known.joint_names if known else ())]
    sizes = [output.shape[-1] for output in facts.outputs if output.shape]
    given = {size for size in sizes if size is not None and size > 1}
    count = known.joint_count if known else 0
    if names and set(names) != own:
        source = known.sources.get("joint_names", "the file") if known else "the file"
        reason = f"{source} names {plural(len(names), 'joint')}, {', '.join(names)[:200]}"
    elif count and count != len(own):
        reason = f"what lies beside it is about {plural(count, 'joint')}"
    elif given and len(sizes) == len(given) and len(own) not in given:
        reason = f"it gives {' or '.join(map(str, sorted(given)))} numbers"
    else:
        return
    named = " ".join(names) if set(names) != own else ""  # Its own names are a guess of ours.
    looks = next((robot for mark, robot in _LOOKS if re.search(mark, named)), "")
    raise PolicyError(
        f"{facts.path}: it drives another robot than {robot.name}, which has "
        f"{plural(len(own), 'joint')}: {reason}" + (f"; that looks like {looks}" if looks else ""),
        fix="name the robot that it was trained on with --robot",
    )
