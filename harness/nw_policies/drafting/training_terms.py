"""The terms that the observing method of a training joins, found in its text.

In Isaac Gym it is `compute_observations`, in direct environments of Isaac Lab `_get_observations`,
whose readings are those of an articulation: `robot.data.joint_vel`. The method is followed line by
line with names in place of numbers: `self.dof_vel * self.obs_scales.dof_vel` is a term and its
factor. Nothing of it is run. A branch is taken where the settings decide it, else the other one:
noise and delays are of the training alone.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from nw_policies.drafting.constants import UNKNOWN, constant, is_number
from nw_policies.drafting.exporters import ExportedTerm, HeightGrid

OBSERVES = ("compute_observations", "_get_observations")
"""The methods that join what a policy sees."""
_MOST = 200
"""Terms of a row, and calls of methods that are followed."""
_NEAR = 1e-3
"""m by which a point of a grid may be off."""
_PERIODS = ("cycle_time", "period", "gait_period", "gait_cycle")
_FREQUENCIES = ("step_freq", "gait_frequency", "gait_freq")
_ACTS = "_pre_physics_step"
"""The method of a direct environment that takes the actions."""
_DEEPEST = 4
"""Methods that call one another."""
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
_OWNER = r"(?:[\w.\[\]']+\.)?"
"""Whose reading it is: `self._robot.`, `self.scene['robot'].`."""
_OF_ARTICULATION = (
    (r"data\.(root_(com_)?lin_vel_b)", ("lin_vel", 3, "")),
    (r"data\.(root_(com_)?ang_vel_b|ang_vel_b)", ("ang_vel", 3, "")),
    (r"data\.(projected_gravity_b)", ("gravity", 3, "")),
    (r"data\.(joint_pos)", ("joint_pos", None, "relative: false")),
    (r"data\.(joint_vel)", ("joint_vel", None, "")),
    (r"self\.(_?commands?)|command_generator\.(command)", ("command", 3, "")),
    (r"self\.(_?actions?)|(action_buffer)\.[\w.]*buffer\[:, -1(, :)?\]", ("last_output", None, "")),
)
"""The same of Isaac Lab's articulations and IMUs, and of what direct environments hold."""


@dataclass(frozen=True, kw_only=True)
class Environment:
    """A class of an environment with its settings."""

    settings: Mapping[str, Any]
    methods: Sequence[Mapping[str, ast.FunctionDef]]
    """Of the class, and of those below it: what overrides another comes first."""
    joints: int
    is_lab: bool = False
    """Whether it is of Isaac Lab, whose articulations have other names."""
    size: int = 0
    """Numbers that the checkpoint takes; 0 where it does not say."""


Row = tuple[ExportedTerm, ...]


class _Reading:
    """What names and attributes hold while a method is followed."""

    def __init__(self, environment: Environment) -> None:
        self.about = environment
        self.held: dict[str, Row] = {}
        self.notes: list[str] = []
        self._texts: dict[str, str] = {}
        self._target = ""
        self._depth = self._calls = 0
        normal = environment.settings.get("normalization", {})
        scales = normal.get("obs_scales", {}) if isinstance(normal, dict) else {}
        env = environment.settings.get("env", {})
        # Of `self`: the settings, the factors, and the sizes as environments name them.
        own: dict[str, Any] = {"cfg": environment.settings, "obs_scales": scales}
        if isinstance(env, dict) and env:
            own |= cast("dict[str, Any]", env)
            own["num_obs"] = own.get("num_observations", UNKNOWN)
            own["num_one_step_obs"] = own.get("num_one_step_observations", UNKNOWN)
        elif environment.is_lab:
            own |= environment.settings
        self.names: dict[str, Any] = {"self": own, "cfg": environment.settings}
        self.constants: dict[str, Any] = {}
        self.clip: float | None = None
        """Limit of raw actions of a direct environment; None without one."""
        if environment.is_lab:
            self._acts()
            for method in (m for inner in reversed(environment.methods) for m in inner.values()):
                if method.name not in OBSERVES:
                    self._settle(method.body)
        self.factors = self._command_factors()
        self.period = self._period()

    def _settle(self, lines: Sequence[ast.stmt]) -> None:
        """Keep the numbers and lists of numbers that methods give to attributes of `self`."""
        for line in lines:
            match line:
                case ast.If(test=test, body=body, orelse=other):
                    self._settle(body if self._is_true(test) else other)
                case ast.Assign(targets=[ast.Attribute(attr=name)], value=value):
                    while isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute):
                        if value.func.attr == "tensor" and value.args:
                            value = value.args[0]
                        elif value.func.attr in {"repeat", "to", "unsqueeze", "expand"}:
                            value = value.func.value
                        else:
                            break
                    known = constant(value, self.names)
                    numbers = cast("list[Any]", known) if isinstance(known, list) else [known]
                    if numbers and all(map(is_number, numbers)):
                        self.constants[name.lstrip("_")] = known
                case _:
                    pass

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
        of_lab = (self.constants.get(name) for name in _FREQUENCIES)
        if frequency := next((one for one in of_lab if is_number(one) and one > 0), None):
            return 1.0 / frequency
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

    def follow(self, lines: Sequence[ast.stmt]) -> bool:
        """Follow lines of a method up to its end, and say whether they come to it."""
        for line in lines:
            match line:
                case ast.Assign(targets=[target], value=value):
                    self._hold(target, value)
                case ast.Return(value=ast.expr() as value):
                    self.held["return"] = self.row(value)
                    return True
                case ast.AnnAssign(target=target, value=ast.expr() as value):
                    self._hold(target, value)
                case ast.If() if self._branches(line):
                    return True
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
        return False

    def _branches(self, line: ast.If) -> bool:
        """Follow the branch that is taken, and say whether the method comes to its end in it."""
        if _is_noise(line.test):
            return self.follow(line.orelse)
        if self.about.is_lab:
            self._doubt(line.test, line.body)
        return self.follow(line.body if self._is_true(line.test) else line.orelse)

    def _doubt(self, test: ast.expr, body: Sequence[ast.stmt]) -> None:
        """Note what a branch would change that the settings do not decide, and is not taken."""
        text = ast.unparse(test)
        if constant(test, self.names) is not UNKNOWN or self._is_true(test):
            return
        names = [ast.unparse(each.targets[0]) for each in body if isinstance(each, ast.Assign)]
        if names and self._depth:
            self.notes.append(f"{names[-1]} is another where {text[:120]}")

    def _hold(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name | ast.Attribute):
            before, self._target = self._target, ast.unparse(target)
            self._texts[self._target] = ast.unparse(value)
            self.held[self._target] = self.row(value)
            self._target = before
        elif isinstance(target, ast.Subscript):
            self._changed(target, value)
        elif isinstance(target, ast.Tuple):
            first, *others = target.elts
            for other in others:
                self._forget(other, value)
            if isinstance(value, ast.Call):  # Of what a method returns, the first is for a policy.
                self._hold(first, value)
            else:
                self._forget(first, value)

    def _changed(self, target: ast.expr, value: ast.expr) -> None:
        """Follow numbers that are set in place: a clock that rests while the command is to stand.

        `clock[:, :] = clock * moves + -1.0 * ~moves`, of `moves = norm(commands) > 0.01`. What else
        is changed so is unknown.
        """
        name, text = ast.unparse(cast("ast.Subscript", target).value), ast.unparse(value)
        row = self.held.get(name, ())
        rests = re.search(r"(-?[\d.]+) \* ~(\w+)", text)
        moves = re.search(
            r"norm\(.*command.*> ([\d.]+)$", self._texts.get(rests[2], "") if rests else ""
        )
        if rests and moves and len(row) == 1 and row[0].own == "clock":
            keys = f"{row[0].keys}, standing: {{below: {moves[1]}, phase: {float(rests[1]):g}}}"
            self.held[name] = (replace(row[0], keys=keys),)
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
        if self.about.is_lab:
            found = self._of_articulation(text)
            found = self._handed_on(node) if found is None else found
            if found is not None:
                return found
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

    def _handed_on(self, node: ast.expr) -> Row | None:
        """Return the terms of what only holds others: a buffer, or what is for the policy."""
        match node:
            case ast.Constant(value=None):
                return ()
            case ast.Attribute(value=base, attr="buffer" | "T"):
                return self.row(base)
            case ast.Tuple(elts=[first, *_]):
                return self.row(first)
            case ast.Dict(keys=keys, values=values):
                for key, value in zip(keys, values, strict=True):
                    if isinstance(key, ast.Constant) and key.value == "policy":
                        return self.row(value)
                return None
            case _:
                return None

    def _of_robot(self, name: str) -> ExportedTerm:
        own, width, keys = _OF_ROBOT[name]
        return ExportedTerm(
            name=name, own=own, width=width or self.about.joints, keys=keys, scale=(1.0,)
        )

    def _of_articulation(self, text: str) -> Row | None:
        """Return the term of a reading of Isaac Lab, of a clock, or of fixed numbers."""
        for pattern, (own, width, keys) in _OF_ARTICULATION:
            if match := re.fullmatch(rf"{_OWNER}(?:{pattern})", text):
                name = next(group for group in match.groups() if group)
                clipped = "clipped: true" if own == "last_output" and self.clip else keys
                return (
                    ExportedTerm(
                        name=name,
                        own=own,
                        width=width or self.about.joints,
                        keys=clipped,
                        scale=(1.0,),
                    ),
                )
        if re.fullmatch(r"self\.\w*phase(_signal)?", text) and self.offsets:
            return self._clock("phase")
        known = self.constants.get(text.removeprefix("self.").lstrip("_"))
        if text.startswith("self.") and isinstance(known, list):
            keys = f"values: [{', '.join(f'{value:g}' for value in cast('list[float]', known))}]"
            return (
                ExportedTerm(
                    name=text.removeprefix("self."),
                    own="constant",
                    width=len(cast("list[Any]", known)),
                    keys=keys,
                    scale=(1.0,),
                ),
            )
        return None

    @property
    def offsets(self) -> list[float]:
        """Phases of the feet at the start, in cycles; empty where no list has them."""
        found = next((v for k, v in self.constants.items() if k.endswith("phase_offset")), None)
        return cast("list[float]", found) if isinstance(found, list) else []

    def _acts(self) -> None:
        """Look what a direct environment does to raw actions: the limit, and filters as notes."""
        steps = [own[_ACTS] for own in self.about.methods if _ACTS in own]
        for node in (node for line in steps[:1] for node in ast.walk(line)):
            match node:
                case ast.Call(
                    func=ast.Attribute(attr="clamp" | "clip"), args=[clamped, low, limit]
                ) if "actions" in ast.unparse(clamped):
                    value = constant(limit, self.names)
                    is_even = is_number(value) and constant(low, self.names) == -value < 0
                    self.clip = float(value) if is_even else None
                case ast.If(test=test, body=body) if self._is_true(test):
                    self.notes += [
                        "its actions are filtered by those before, and the card's are not: "
                        + ast.unparse(line)[:120]
                        for line in body
                        if "previous_action" in ast.unparse(line)
                    ]
                case _:
                    pass

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
        if name in {"cat", "concat", "concatenate", "hstack", "stack", "vstack"} and node.args:
            items = node.args[0]
            if isinstance(items, ast.ListComp):
                return self._kept(items)
            return self._listed(items.elts) if isinstance(items, ast.Tuple | ast.List) else None
        if ast.unparse(node.func) == f"self.{name}":
            return self._returned(name)
        if name in {"sin", "cos"} and node.args:
            value = "sine" if name == "sin" else "cosine"
            return self._clock(value) if _is_turn(node.args[0]) else None
        if name in _SAME | _LIMITS and isinstance(node.func, ast.Attribute):
            is_function = isinstance(node.func.value, ast.Name) and node.func.value.id == "torch"
            if not is_function:
                args = [node.func.value, *node.args]
            elif not (args := node.args):
                return None
            row = self.row(args[0])
            return self._limited(row, args[1:], node.keywords) if name in _LIMITS else row
        return None

    def _listed(self, items: Sequence[ast.expr]) -> Row | None:
        """Return the terms of several expressions; columns of one, from the first on, are it."""
        columns = [ast.unparse(item) for item in items]
        whole = re.sub(r"\[:, 0\]$", "", columns[0]) if columns else ""
        if len(columns) > 1 and columns == [f"{whole}[:, {n}]" for n in range(len(columns))]:
            row = self.row(_path(whole))
            if sum(term.width or 0 for term in row) == len(columns):
                return row
        row = [term for item in items for term in self.row(item)]
        return tuple(row) if len(row) <= _MOST else None

    def _returned(self, name: str) -> Row | None:
        """Return the terms that another method of the environment returns, the first of several."""
        method = next((own[name] for own in self.about.methods if name in own), None)
        if method is None or self._depth >= _DEEPEST or self._calls >= _MOST:
            return None
        self._depth += 1
        self._calls += 1
        # Names of the one method are not those of the other; attributes are.
        kept, self.held = self.held, _attributes(self.held)
        self.follow(method.body)
        found = self.held.get("return")
        self.held = {**kept, **_attributes(self.held)}
        self._depth -= 1
        return found

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
        """Return a frame of `[kept[i] for i in range(n)]` or of `[each for each in kept]`.

        Of `[each for each in (a, b) if each is not None]` it is the terms of a and b.
        """
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
            case ast.ListComp(
                elt=ast.Name(id=name),
                generators=[
                    ast.comprehension(
                        target=ast.Name(id=each),
                        iter=ast.Tuple(elts=parts) | ast.List(elts=parts),
                        ifs=[
                            ast.Compare(
                                left=ast.Name(id=asked),
                                ops=[ast.IsNot()],
                                comparators=[ast.Constant(value=None)],
                            )
                        ],
                    )
                ],
            ) if name == each == asked:
                return self._listed(parts)
            case _:  # Another order, or some of them.
                return None

    def _clock(self, value: str) -> Row | None:
        if self.period is None:
            return None
        keys, width = f"frequency: {1 / self.period:.6g}, values: [{value}]", 1
        if self.offsets:
            width = len(self.offsets)
            keys += f", offsets: [{', '.join(f'{offset:g}' for offset in self.offsets)}]"
        return (ExportedTerm(name=value, own="clock", width=width, keys=keys, scale=(1.0,)),)

    def _joined(self, node: ast.BinOp) -> Row | None:
        """Return a term with a factor, without the default pose, or without noise."""
        left, right, text = node.left, node.right, ast.unparse(node.right)
        match node.op:
            case ast.Mult() | ast.Div():
                if "commands_scale" in text and not self.factors:
                    return tuple(replace(term, scale=None) for term in self.row(left))
                for one, other in ((left, right), (right, left)):
                    factors = self._factors(other)
                    if not factors or (isinstance(node.op, ast.Div) and one is not left):
                        continue
                    if isinstance(node.op, ast.Div):
                        factors = tuple(1 / factor for factor in factors if factor)
                    return tuple(_scaled(term, factors) for term in self.row(one))
                return None
            case ast.Sub() if ast.unparse(left) == "self.dof_pos" and "default" in text:
                return (replace(self._of_robot("dof_pos"), keys=""),)
            case ast.Sub() if self.about.is_lab and (
                default := re.fullmatch(rf"{_OWNER}data\.default_(joint_pos|joint_vel)", text)
            ):
                row = self.row(left)
                is_it = len(row) == 1 and (row[0].own, row[0].scale) == (default[1], (1.0,))
                return (replace(row[0], keys=""),) if is_it else None
            case ast.Sub() if text == "self.measured_heights":
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
        text = ast.unparse(base)
        is_past = text == self._target and text.startswith("self.") and text not in self.held
        if text == "self.obs_buf" or is_past:
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


def _attributes(held: Mapping[str, Row]) -> dict[str, Row]:
    return {name: row for name, row in held.items() if name.startswith("self.")}


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


@dataclass(frozen=True, kw_only=True)
class SeenTerms:
    """What the observing method of an environment joins, and how its actions are limited."""

    terms: Row = ()
    """With their frames; empty where they are unknown."""
    clip: float | None = None
    """Limit of raw actions; None without one, or outside of Isaac Lab."""
    notes: tuple[str, ...] = ()


def seen_terms(environment: Environment) -> SeenTerms:
    """Return what a policy sees, by the text of its environment.

    Of terms that are unknown one has the numbers that the settings leave for it.
    """
    reading = _Reading(environment)
    method = next(own[name] for own in environment.methods for name in OBSERVES if name in own)
    reading.follow(method.body)
    row = reading.held.get("return" if environment.is_lab else "self.obs_buf", ())
    return SeenTerms(
        terms=_framed(row, reading.names["self"], environment.size),
        clip=reading.clip,
        notes=tuple(dict.fromkeys(reading.notes)),
    )


_TOTALS = ("num_observations", "observation_space")
_FRAMES = "actor_obs_history_length"
_SINGLES = ("num_single_obs", "num_one_step_observations", "single_observation_space")


def _framed(row: Row, own: Mapping[str, Any], size: int) -> Row:
    """Return the terms of a frame with the number of frames, by the sizes of the settings."""
    newest_first = any(term.own == _PAST for term in row[1:])
    frame = [term for term in row if term.own != _PAST]
    unknown = [index for index, term in enumerate(frame) if not term.width]
    total = next((own[key] for key in _TOTALS if is_number(own.get(key))), size or UNKNOWN)
    known = sum(term.width or 0 for term in frame)
    of_robot = own.get("robot")
    if total is UNKNOWN and not unknown and isinstance(of_robot, dict):  # As legged_lab says it.
        frames = cast("dict[str, Any]", of_robot).get(_FRAMES)
        total = frames * known if is_number(frames) else UNKNOWN
    if not frame or len(unknown) == len(frame) or not is_number(total):
        return ()
    singles = [own[key] for key in _SINGLES if key in own]
    if not unknown and known and all(single == total for single in singles):
        singles = [total, known]  # What a buffer keeps is so many frames.
    for single in (*singles, total):
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
