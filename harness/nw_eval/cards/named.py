"""Unions of models that are told apart by a name: what is built in, and one model for the rest.

The union is the table: each model says its own name, as the `Literal` of one of its keys. From that
follow the names that are built in, the branch that a mapping falls into, and the JSON Schema. The
names of installed packages are looked up in `nw_eval.plugins`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

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
