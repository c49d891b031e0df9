"""JSON Schemas of the files that people write, every key with its meaning."""

from __future__ import annotations

import ast
import inspect
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema


def json_schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a model, described by its docstrings."""
    return model.model_json_schema(by_alias=True, schema_generator=_Described)


class _Described(GenerateJsonSchema):
    """Describes properties by the docstrings under the fields.

    Pydantic's own `use_attribute_docstrings` reads the sources whenever the classes are imported,
    which adds a third to the time in which a first card is read; here it is done on demand.
    """

    def model_schema(self, schema: core_schema.ModelSchema) -> dict[str, Any]:
        result = super().model_schema(schema)
        model: type[BaseModel] = schema["cls"]
        docstrings = _field_docstrings(model)
        for name, field in model.model_fields.items():
            key = result["properties"][field.alias or name]
            if name in docstrings:
                key["description"] = docstrings[name]
            elif "const" in key:  # `term: ang_vel` means what its class is.
                key["description"] = result["description"]
        return result


def _field_docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the strings that stand under the fields of a model and its bases, by name."""
    docstrings: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if cls is BaseModel or not issubclass(cls, BaseModel):
            continue
        (body,) = ast.parse(inspect.getsource(cls)).body
        assert isinstance(body, ast.ClassDef), "the source of a class is one statement"
        for field, note in pairwise(body.body):
            match field, note:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    docstrings[name] = inspect.cleandoc(text)
                case _:
                    pass
    return docstrings
