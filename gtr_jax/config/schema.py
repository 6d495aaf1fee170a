"""The JSON Schema of the robot file, generated from the classes that read it.

`python -m gtr_jax.config.schema` writes it to docs/robot.schema.json.
"""

from __future__ import annotations

import ast
import functools
import inspect
import itertools
import json
import os
import sys
from collections.abc import Iterator
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from gtr_jax.atomic_write import write_atomically

from .config import RobotConfig
from .section import Section


class Described(GenerateJsonSchema):
    """Keys are described by what stands below them in their class, which is read here only."""

    def model_schema(self, schema: Any) -> dict[str, Any]:
        """The schema of one table."""
        made = super().model_schema(schema)
        section = schema["cls"]
        for name, says in _descriptions(section):
            made["properties"][section.model_fields[name].alias or name]["description"] = says
        return made


def says_of(config: RobotConfig, key: str) -> str:
    """What stands below a key of the robot file in the class of its table; "" below none.

    Args:
        config: the robot file.
        key: dotted, as of a parameter: "routing.r1", "tendons.left.to", "backbone.bores.0.diameter".
    """
    node: Any = config
    says = ""
    for part in key.split("."):
        if isinstance(node, Section):
            name = next((n for n, f in type(node).model_fields.items() if part in (n, f.alias)), "")
            says, node = _described(type(node)).get(name, ""), getattr(node, name, None)
        elif isinstance(node, tuple):
            there = enumerate(node)
            node = next((own for i, own in there if part in (str(i), getattr(own, "name", None))), None)
    return says


@functools.cache
def _described(section: type) -> dict[str, str]:
    return dict(_descriptions(section))


def _descriptions(section: type) -> Iterator[tuple[str, str]]:
    """Keys of a section with the text below each, in the source of its class or of one that it extends."""
    for part in section.__mro__:
        if issubclass(part, Section) and getattr(sys.modules[part.__module__], part.__name__, None) is part:
            for node in ast.walk(ast.parse(inspect.getsource(part))):
                for field, below in itertools.pairwise(_statements(node)):
                    if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                            yield field.target.id, inspect.cleandoc(str(below.value.value))


def _statements(node: ast.AST) -> list[ast.stmt]:
    """What stands directly in a class, or in either part of a condition."""
    if isinstance(node, ast.ClassDef):
        return node.body
    return [*node.body, *node.orelse] if isinstance(node, ast.If) else []


def json_schema() -> dict[str, Any]:
    """JSON Schema of the robot file, with which editors complete and check such files."""
    schema = RobotConfig.model_json_schema(by_alias=True, schema_generator=Described)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schema(path: str | os.PathLike[str]) -> None:
    """Write the JSON Schema of the robot file."""
    write_atomically(path, json.dumps(json_schema(), indent=2) + "\n")


if __name__ == "__main__":
    write_schema(sys.argv[1] if len(sys.argv) > 1 else "docs/robot.schema.json")
