"""The terms that a training's `compute_observations` joins, found in its text.

The method is followed line by line with names in place of numbers: `self.dof_vel *
self.obs_scales.dof_vel` is a term and its factor. Nothing of it is run. A branch is taken where the
settings decide it, else the other one: noise and delays are of the training alone.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from nw_policies.drafting.checkpoint import ExportedTerm, HeightGrid
from nw_policies.drafting.constants import UNKNOWN, constant, is_number

OBSERVES = "compute_observations"
"""The method that joins what a policy sees."""
_MOST = 200
"""Terms of a row."""
_NEAR = 1e-3
"""m by which a point of a grid may be off."""
_PERIODS = ("cycle_time", "period", "gait_period")
_SAME = frozenset(
    {"clone", "unsqueeze", "squeeze", "view", "reshape", "flatten", "detach", "float", "to"}
    | {"contiguous"}
)
"""Methods and functions behind which a term has the same numbers."""
_LIMITS = frozenset({"clip", "clamp"})
_NOISE = re.compile(r"noise|rand|bias|offset|lag|latency", re.IGNORECASE)
_PAST = "the frames before"
_OF_ROBOT = {
    "dof_pos": ("joint_pos", None, "relative: false"),
    "dof_vel": ("joint_vel", None, ""),
    "actions": ("last_output", None, "clipped: true"),
    "base_lin_vel": ("lin_vel", 3, ""),
    "base_ang_vel": ("ang_vel", 3, ""),
    "projected_gravity": ("gravity", 3, ""),
    "base_euler_xyz": ("roll_pitch+yaw", 3, ""),
    "commands": ("command", 3, ""),
}
"""What an attribute of the environment is on a card: term, numbers (None = one for each joint)."""


@dataclass(frozen=True, kw_only=True)
class Environment:
    """A class of an environment with its settings."""

    settings: Mapping[str, Any]
    methods: Sequence[Mapping[str, ast.FunctionDef]]
    """Of the class, and of those below it: what overrides another comes first."""
    joints: int


Row = tuple[ExportedTerm, ...]


class _Reading:
    """What names and attributes hold while a method is followed."""

    def __init__(self, environment: Environment) -> None:
        self.about = environment
        self.held: dict[str, Row] = {}
        normal = environment.settings.get("normalization", {})
        scales = normal.get("obs_scales", {}) if isinstance(normal, dict) else {}
        env = environment.settings.get("env", {})
        # Of `self`: the settings, the factors, and the sizes as environments name them.
        own: dict[str, Any] = {"cfg": environment.settings, "obs_scales": scales}
        if isinstance(env, dict):
            own |= cast("dict[str, Any]", env)
            own["num_obs"] = own.get("num_observations", UNKNOWN)
            own["num_one_step_obs"] = own.get("num_one_step_observations", UNKNOWN)
        self.names: dict[str, Any] = {"self": own}
        self.factors = self._command_factors()
        self.period = self._period()

    def _command_factors(self) -> tuple[float, ...]:
        """Return the factors of the command, from where the environment sets them."""
        for method in (method for own in self.about.methods for method in own.values()):
            for line in ast.walk(method):
                match line:
                    case ast.Assign(targets=[target], value=ast.Call(args=[factors, *_])) if (
                        ast.unparse(target) == "self.commands_scale"
                    ):
                        value = constant(factors, self.names)
                    case _:
                        continue
                if isinstance(value, list) and all(map(is_number, cast("list[Any]", value))):
                    return tuple(map(float, cast("list[float]", value)[:3]))
        return ()

    def _period(self) -> float | None:
        """Return the period of a gait, s, that the nearest class names; None without one."""
        for own in self.about.methods:
            found = {period for method in own.values() for period in self._periods(method)}
            if found:
                return found.pop() if len(found) == 1 else None
        return None

    def _periods(self, method: ast.FunctionDef) -> Iterator[float]:
        for node in ast.walk(method):
            value: Any = UNKNOWN
            if isinstance(node, ast.Attribute) and node.attr in _PERIODS:
                value = constant(node, self.names)
            elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in _PERIODS:
                value = constant(node.value, self.names)
            if is_number(value) and value > 0:
                yield float(value)

    def follow(self, lines: Sequence[ast.stmt]) -> None:
        """Follow lines of the method."""
        for line in lines:
            match line:
                case ast.Assign(targets=[target], value=value):
                    self._hold(target, value)
                case ast.AnnAssign(target=target, value=ast.expr() as value):
                    self._hold(target, value)
                case ast.If(test=test, body=body, orelse=other):
                    self.follow(body if self._is_true(test) and not _is_noise(test) else other)
                case ast.AugAssign(target=target, op=ast.Add(), value=value) if _is_noise(value):
                    pass
                case ast.AugAssign(target=target):
                    self._forget(target, line)
                case ast.Expr(
                    value=ast.Call(func=ast.Attribute(value=kept, attr="append"), args=[frame])
                ):
                    self.held[ast.unparse(kept)] = self.row(frame)
                case _:
                    pass

    def _hold(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name | ast.Attribute):
            self.held[ast.unparse(target)] = self.row(value)
        else:
            self._forget(target, value)

    def _forget(self, target: ast.expr, line: ast.AST) -> None:
        """Take what a line changes a part of, or computes with, for one term that is unknown."""
        while isinstance(target, ast.Subscript):
            target = target.value
        if (name := ast.unparse(target)) in self.held:
            self.held[name] = (_unknown(ast.unparse(line)),)

    def _is_true(self, test: ast.expr) -> bool:
        """Whether the settings say that a branch is taken."""
        match test:
            case ast.Compare(left=left, ops=[ast.Is() | ast.IsNot() as op], comparators=[right]):
                one, other = constant(left, self.names), constant(right, self.names)
                same = one is other
                return UNKNOWN not in (one, other) and same is isinstance(op, ast.Is)
            case ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]):
                one, other = constant(left, self.names), constant(right, self.names)
                return one is not UNKNOWN and bool(one == other)
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return constant(inner, self.names) is not UNKNOWN and not self._is_true(inner)
            case _:
                value = constant(test, self.names)
                return value is not UNKNOWN and bool(value)

    def row(self, node: ast.expr) -> Row:
        """Return the terms of an expression; one without a word of a card where it is unknown."""
        text = ast.unparse(node)
        if text in self.held:
            return self.held[text]
        match node:
            case ast.Attribute(value=ast.Name(id="self"), attr=name) if name in _OF_ROBOT:
                return (self._of_robot(name),)
            case ast.Call():
                found = self._called(node)
            case ast.BinOp():
                found = self._joined(node)
            case ast.Subscript(value=base, slice=part):
                found = self._part(base, part)
            case _:
                found = None
        return (_unknown(text),) if found is None else found

    def _of_robot(self, name: str) -> ExportedTerm:
        own, width, keys = _OF_ROBOT[name]
        return ExportedTerm(
            name=name, own=own, width=width or self.about.joints, keys=keys, scale=(1.0,)
        )

    def _heights(self, above: ast.expr) -> Row | None:
        """Return the scan of what is `above` less the heights, whose points follow along y."""
        terrain = constant(_path("self.cfg.terrain"), self.names)
        axes = [
            terrain.get(f"measured_points_{axis}") if isinstance(terrain, dict) else None
            for axis in "xy"
        ]
        offset: Any = 0
        match above:
            case ast.BinOp(left=left, op=ast.Sub() | ast.Add() as op, right=right):
                above, offset = left, constant(right, self.names)
                offset = -offset if is_number(offset) and isinstance(op, ast.Sub) else offset
            case _:
                pass
        is_of_trunk = "[:, 2]" in ast.unparse(above) and not isinstance(above, ast.BinOp)
        if not is_of_trunk or not is_number(offset) or not all(map(_is_even, axes)):
            return None
        x, y = ((axis[0], axis[-1], len(axis)) for axis in cast("list[list[float]]", axes))
        grid = HeightGrid(x=x, y=y, order="y_fastest", offset=float(offset), body="")
        name, width = "measured_heights", x[2] * y[2]
        return (ExportedTerm(name=name, width=width, grid=grid, scale=(1.0,)),)

    def _called(self, node: ast.Call) -> Row | None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        if name in {"cat", "concat", "concatenate", "hstack", "stack"} and node.args:
            items = node.args[0]
            if isinstance(items, ast.ListComp):  # The frames that a list keeps.
                return self._kept(items)
            if isinstance(items, ast.Tuple | ast.List):
                row = [term for item in items.elts for term in self.row(item)]
                return tuple(row) if len(row) <= _MOST else None
            return None
        if name in {"sin", "cos"} and node.args:
            return self._clock(node.args[0], "sine" if name == "sin" else "cosine")
        if name in _SAME | _LIMITS and isinstance(node.func, ast.Attribute):
            is_function = isinstance(node.func.value, ast.Name) and node.func.value.id == "torch"
            if not is_function:
                args = [node.func.value, *node.args]
            elif not (args := node.args):
                return None
            row = self.row(args[0])
            return self._limited(row, args[1:], node.keywords) if name in _LIMITS else row
        return None

    def _limited(
        self, row: Row, limits: Sequence[ast.expr], keywords: Sequence[ast.keyword]
    ) -> Row | None:
        """Return terms within limits, which a card has before the factor; of one term alone.

        A whole row is limited as the settings say, with `clip_observations`.
        """
        if len(row) != 1:
            return row
        named = {each.arg: each.value for each in keywords}
        ends = [*limits, *(named[key] for key in ("min", "max") if key in named)]
        low, high = [constant(end, self.names) for end in ends] if len(ends) == 2 else [UNKNOWN] * 2
        term, factors = row[0], set(row[0].scale or ())
        factor = factors.pop() if len(factors) == 1 else 0.0
        if not is_number(low) or not is_number(high) or factor <= 0.0 or term.clip is not None:
            return None
        return (replace(term, clip=(low / factor, high / factor)),)

    def _kept(self, frames: ast.ListComp) -> Row | None:
        """Return a frame of `[kept[i] for i in range(n)]` or of `[each for each in kept]`."""
        match frames:
            case ast.ListComp(
                elt=ast.Subscript(value=kept, slice=ast.Name(id=index)),
                generators=[
                    ast.comprehension(
                        target=ast.Name(id=number),
                        iter=ast.Call(func=ast.Name(id="range"), args=[_]),
                        ifs=[],
                    )
                ],
            ) if index == number:
                return self.held.get(ast.unparse(kept))
            case ast.ListComp(
                elt=ast.Name(id=name),
                generators=[ast.comprehension(target=ast.Name(id=each), iter=kept, ifs=[])],
            ) if name == each:
                return self.held.get(ast.unparse(kept))
            case _:  # Another order, or some of them.
                return None

    def _clock(self, angle: ast.expr, value: str) -> Row | None:
        if self.period is None or not _is_turn(angle):
            return None
        keys = f"frequency: {1 / self.period:g}, values: [{value}]"
        return (ExportedTerm(name=value, own="clock", width=1, keys=keys, scale=(1.0,)),)

    def _joined(self, node: ast.BinOp) -> Row | None:
        """Return a term with a factor, without the default pose, or without noise."""
        left, right = node.left, node.right
        match node.op:
            case ast.Mult() | ast.Div():
                if "commands_scale" in ast.unparse(right) and not self.factors:
                    return tuple(replace(term, scale=None) for term in self.row(left))
                for one, other in ((left, right), (right, left)):
                    factors = self._factors(other)
                    if not factors or (isinstance(node.op, ast.Div) and one is not left):
                        continue
                    if isinstance(node.op, ast.Div):
                        factors = tuple(1 / factor for factor in factors if factor)
                    return tuple(_scaled(term, factors) for term in self.row(one))
                return None
            case ast.Sub() if ast.unparse(left) == "self.dof_pos" and "default" in ast.unparse(
                right
            ):
                return (replace(self._of_robot("dof_pos"), keys=""),)
            case ast.Sub() if ast.unparse(right) == "self.measured_heights":
                return self._heights(left)
            case ast.Add() if _is_noise(right):
                return self.row(left)
            case _:
                return None

    def _factors(self, node: ast.expr) -> tuple[float, ...]:
        if "commands_scale" in ast.unparse(node):
            return self.factors
        value = constant(node, self.names)
        return (float(value),) if is_number(value) else ()

    def _part(self, base: ast.expr, part: ast.expr) -> Row | None:
        """Return the numbers of a term that a slice keeps: the first ones, or all."""
        if ast.unparse(base) == "self.obs_buf":
            return (ExportedTerm(name=_PAST, own=_PAST, width=0),)
        row = self.row(base)
        last = part.elts[-1] if isinstance(part, ast.Tuple) else part
        if not isinstance(last, ast.Slice) or last.step is not None:
            return None
        low = 0 if last.lower is None else constant(last.lower, self.names)
        high = UNKNOWN if last.upper is None else constant(last.upper, self.names)
        if last.upper is None and low == 0:
            return row
        if row and row[0].own == "roll_pitch+yaw" and (low, high) == (0, 2):
            return (replace(row[0], own="roll_pitch", width=2),)
        if low != 0:
            return None
        kept: list[ExportedTerm] = []
        for term in row:
            if sum(each.width or 0 for each in kept) == high:
                break
            kept.append(term)
        return tuple(kept) if sum(each.width or 0 for each in kept) == high else None


def _unknown(text: str) -> ExportedTerm:
    return ExportedTerm(name=text[:80])


def _is_even(axis: Any) -> bool:
    """Whether numbers are those of an axis, each as far from the one before."""
    if not isinstance(axis, list) or not axis or not all(map(is_number, cast("list[Any]", axis))):
        return False
    points = cast("list[float]", axis)
    step = (points[-1] - points[0]) / max(1, len(points) - 1)
    return all(abs(points[0] + i * step - point) < _NEAR for i, point in enumerate(points))


def _is_noise(node: ast.expr) -> bool:
    return _NOISE.search(ast.unparse(node)) is not None


def _is_turn(angle: ast.expr) -> bool:
    """Whether an angle is 2 pi times a phase, in any order."""
    factors, words = [angle], list[str]()
    while factors:
        match factors.pop():
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                factors += [left, right]
            case ast.Constant(value=2 | 2.0):
                words.append("2")
            case ast.Attribute(attr="pi"):
                words.append("pi")
            case ast.BinOp():
                return False
            case other:
                words.append("phase" if "phase" in ast.unparse(other) else "")
    return sorted(words) == ["2", "phase", "pi"]


def _path(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _scaled(term: ExportedTerm, factors: tuple[float, ...]) -> ExportedTerm:
    before = term.scale or (1.0,)
    if len(factors) == 1:
        return replace(term, scale=tuple(one * factors[0] for one in before))
    return replace(term, scale=tuple(one * before[0] for one in factors))


def seen_terms(environment: Environment) -> Row:
    """Return the terms of what the policy sees, with their frames; empty where they are unknown.

    Of terms that are unknown one has the numbers that the settings leave for it.
    """
    reading = _Reading(environment)
    observes = next(own[OBSERVES] for own in environment.methods if OBSERVES in own)
    reading.follow(observes.body)
    row = reading.held.get("self.obs_buf", ())
    newest_first = any(term.own == _PAST for term in row[1:])
    frame = [term for term in row if term.own != _PAST]
    unknown = [index for index, term in enumerate(frame) if not term.width]
    own = reading.names["self"]
    total = own.get("num_observations", UNKNOWN)
    if not frame or len(unknown) == len(frame) or not is_number(total):
        return ()
    frames = [own[key] for key in ("num_single_obs", "num_one_step_observations") if key in own]
    known = sum(term.width or 0 for term in frame)
    for single in (*frames, total):
        if not is_number(single) or single < 1 or total % single or total > 100 * single:
            continue
        left = int(single) - known
        if left == 0 if not unknown else len(unknown) == 1 and left > 0:
            break
    else:
        return ()
    if unknown:
        frame[unknown[0]] = replace(frame[unknown[0]], width=left)
    steps = int(total / single)
    form = f"order: {'newest_first' if newest_first else 'oldest_first'}, by: step"
    clip = (float("-inf"), float("inf"))
    return tuple(replace(term, history=steps, form=form, clip=term.clip or clip) for term in frame)
