"""Scripts that run a policy in a simulator: the order of the terms that they write into a row.

`obs[3:6] = omega * cfg.normalization.obs_scales.ang_vel`, one slice after another from 0 on, says
what a policy sees where no file does, as in ports of DreamWaQ. The script is read as text, never
run; it counts only if it names the checkpoint.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import PurePath
from typing import Any, cast

from nw_policies.cards.joints import short_name
from nw_policies.drafting.constants import UNKNOWN, constant, is_number
from nw_policies.drafting.exporters import ExportedTerm, ExporterMetadata
from nw_policies.drafting.layouts import LEG_BY_LEG
from nw_policies.drafting.notation import plain
from nw_policies.drafting.training_code import CodeClasses
from nw_scenes.robots import RobotSpec

_MOST = 40
"""Slices of a row, and names that a text is followed through."""
_WORDS = (
    (r"gravity", ("projected_gravity", "gravity", "")),
    (r"omega|ang_?vel|gyro|qvel\[3:6\]", ("ang_vel", "ang_vel", "")),
    (r"lin_?vel|qvel\[0?:3\]", ("lin_vel", "lin_vel", "")),
    (r"cmd|command|get_velocities", ("commands", "command", "")),
    (r"qvel\[6:|\bdqj?\b|dof_vel|joint_vel|\bqd\b", ("dof_vel", "joint_vel", "")),
    (r"qpos\[7:|\bqj?\b|dof_pos|joint_pos", ("dof_pos", "joint_pos", "relative: false")),
    (r"action", ("actions", "last_output", "")),
)
"""What a text is: its name, a card's word, and further keys; the first that fits counts."""


def read_deploy_script(
    texts: Mapping[str, str], robot: RobotSpec, checkpoint: str, size: int
) -> ExporterMetadata | None:
    """Return what a script that names a checkpoint says of it; None where none does.

    Args:
        texts: name and text of Python files.
        robot: whose joints it drives.
        checkpoint: the path of the file.
        size: numbers that it takes; 0 where it does not say.
    """
    name = PurePath(checkpoint).name
    for file, text in texts.items():
        if name in text:
            try:
                found = _Script(file, text).said(robot, size)
            except (SyntaxError, ValueError, RecursionError, MemoryError):
                continue
            if found is not None:
                return found
    return None


class _Script:
    def __init__(self, file: str, text: str) -> None:
        self._file = file
        self._tree = ast.parse(text.removeprefix("\ufeff"))
        classes = CodeClasses({file: text})
        outer = classes.outer(file)
        settings = [classes.settings(name, file) for name in classes.found]
        self._settings = max(settings, key=lambda one: len(str(one)), default={})
        self._names: dict[str, Any] = {
            **{name: outer[name] for name in outer},
            "cfg": self._settings,
        }
        self._texts = {
            ast.unparse(line.targets[0]): ast.unparse(line.value)
            for line in ast.walk(self._tree)
            if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name)
        }

    def said(self, robot: RobotSpec, size: int) -> ExporterMetadata | None:
        """Return the terms and settings; None where its slices are no whole row of terms."""
        row = self._row()
        terms = [self._term(low, high, value) for low, high, value in row]
        single = row[-1][1] if row else 0
        if None in terms or not single or size % single or len(terms) < 3:
            return None
        steps = size // single or self._number("frame_stack", "history_length") or 1
        form = f"order: {'newest_first' if self._is_newest_first() else 'oldest_first'}, by: step"
        step, every = self._number("dt", "simulation_dt"), self._number("decimation")
        clip = self._number("clip_observations")
        own = [short_name(joint) for joint in robot.joints]
        known = ExporterMetadata(
            joint_names=LEG_BY_LEG if sorted(own) == sorted(LEG_BY_LEG) else tuple(own),
            guessed_order=True,
            joint_stiffness=self._numbers("kps", len(robot.joints)),
            joint_damping=self._numbers("kds", len(robot.joints)),
            default_joint_pos=self._numbers("default_angles", len(robot.joints)),
            action="joint_position_offset",
            action_scale=tuple(filter(None, [self._number("action_scale")])),
            rate=round(1 / (step * every), 6) if step and every else None,
            physics_rate=round(1 / step, 6) if step else None,
            observation_terms=tuple(
                replace(term, history=int(steps), form=form) for term in terms if term is not None
            ),
            observation_clip=clip if ast.unparse(self._tree).count("clip_obs") > 1 else None,
            notes=(
                f"its terms are those that {plain(self._file)} writes, which was read, not run",
            ),
        )
        marked = {f.name: plain(self._file) for f in fields(known) if getattr(known, f.name)}
        return replace(known, sources=marked)

    def _row(self) -> list[tuple[int, int, ast.expr]]:
        """Return bounds and value of the slices of one name that follow one another from 0 on."""
        rows: dict[str, list[tuple[int, int, ast.expr]]] = {}
        for line in ast.walk(self._tree):
            match line:
                case ast.Assign(targets=[ast.Subscript(value=base, slice=part)], value=value):
                    part = part.elts[-1] if isinstance(part, ast.Tuple) else part
                    row = rows.setdefault(ast.unparse(base), [])
                    if not isinstance(part, ast.Slice) or part.upper is None:
                        continue
                    low = 0 if part.lower is None else constant(part.lower, self._names)
                    high = constant(part.upper, self._names)
                    begins = row[-1][1] if row else 0
                    if is_number(low) and is_number(high) and begins == low < high:
                        row.append((int(low), int(high), value))
                case _:
                    pass
        return max(rows.values(), key=len, default=[])[:_MOST]

    def _term(self, low: int, high: int, value: ast.expr) -> ExportedTerm | None:
        """Return a term's name, word, numbers and scale; None where its text says none of them."""
        scale: tuple[float, ...] = (1.0,)
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult):
            factor = constant(value.right, self._names)
            factors = cast("list[Any]", factor) if isinstance(factor, list) else [factor]
            if not all(map(is_number, factors)):
                return None
            scale, value = tuple(map(float, factors)), value.left
        text = whole = ast.unparse(value)
        for _ in range(_MOST):
            name = re.sub(r"\[[^\]]*\]$", "", text)
            if any(re.search(p, text) for p, _ in _WORDS) or name not in self._texts:
                break
            text = self._texts[name]
        for pattern, (name, own, keys) in _WORDS:
            if re.search(pattern, text):
                is_offset = re.search(r" - .*(default|init)", f"{text} {whole}")
                keys = "" if is_offset else keys  # noqa: PLW2901 - relative to the pose.
                return ExportedTerm(
                    name=name,
                    own=own,
                    keys=keys,
                    width=high - low,
                    scale=scale,
                    clip=(float("-inf"), float("inf")),
                )
        return None

    def _is_newest_first(self) -> bool:
        """Whether frames are joined with the present one before those that are kept."""
        text = ast.unparse(self._tree)
        return re.search(r"concatenate\(\(obs\w*, \w*(hist|buf)", text) is not None

    def _values(self, key: str, settings: Mapping[str, Any] | None = None) -> list[Any]:
        own = self._settings if settings is None else settings
        found = [own[key]] if key in own else []
        for inner in own.values():
            if isinstance(inner, dict):
                found += self._values(key, cast("dict[str, Any]", inner))
        return [value for value in found if value is not UNKNOWN]

    def _number(self, *keys: str) -> float | None:
        found = [value for key in keys for value in self._values(key) if is_number(value)]
        return found[0] if found else None

    def _numbers(self, key: str, count: int) -> tuple[float, ...]:
        for value in self._values(key):
            items: Sequence[Any] = cast("list[Any]", value) if isinstance(value, list) else ()
            if len(items) == count and all(map(is_number, items)):
                return tuple(map(float, items))
        return ()
