"""Names of what other packages bring along, beside those of what is built in.

Unions of models are told apart by a name. The union is the table: each model says its own name, as
the `Literal` of one of its keys. From that follow the names that are built in, the branch that a
mapping falls into, and the JSON Schema. Looking a name up imports nothing of the package that has
it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from nw_eval.errors import nearest

SENSORS = "nw_eval.sensors"
WRAPPERS = "nw_eval.wrappers"
"""The entry-point groups."""


@cache
def installed(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of a group by name; several packages may claim one name."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, distribution(p))):
        found[point.name] = (*found.get(point.name, ()), point)
    return found


def distribution(point: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return "unknown package" if point.dist is None else str(point.dist.name)


def is_code(name: str) -> bool:
    """Whether a name is `module:Class` rather than that of something installed."""
    return ":" in name


def known_or_raise(name: str, group: str, built_in: Collection[str]) -> None:
    """Check that a name is installed or `module:Class`.

    Raises:
        ValueError: it is neither.
    """
    if is_code(name):
        module, _, cls = name.partition(":")
        if not (all(part.isidentifier() for part in module.split(".")) and cls.isidentifier()):
            message = f"{name!r} is not a class; write package.module:Class"
            raise ValueError(message)
    elif name not in installed(group):
        message = f"{name!r} is not known; {nearest(name, {*built_in, *installed(group)})}"
        raise ValueError(message)


PLUGIN = "plug-in"
"""The branch that everything falls into which is not built in."""


def names_of(union: Any, key: str) -> tuple[str, ...]:
    """Return the names of a union's models, in its order.

    Args:
        union: of models.
        key: where a model has its name: a `Literal` of one word.
    """
    return tuple(_name_of(model, key) for model in get_args(union))


@dataclass(frozen=True)
class NamedBy:
    """Marks a union whose models have their names under `key`; the one without is the plug-ins'."""

    key: str

    def __get_pydantic_core_schema__(self, union: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema that looks at the name and then reads as that model alone."""
        branches = {
            _name_of(model, self.key): handler.generate_schema(model) for model in get_args(union)
        }

        def branch_of(value: Any) -> str | None:
            is_mapping = isinstance(value, dict)
            name = value.get(self.key) if is_mapping else getattr(value, self.key, None)
            if not isinstance(name, str):
                return None
            return name if name in branches else PLUGIN

        return core_schema.tagged_union_schema(branches, branch_of)


def _name_of(model: type[BaseModel], key: str) -> str:
    names = get_args(model.model_fields[key].annotation)
    return names[0] if names else PLUGIN
