"""The JSON Schema of the robot file, generated from the classes that read it.

`python -m gtr_jax.files.schema` writes it to docs/robot.schema.json.
"""

from __future__ import annotations

import json
import os
from typing import Any

from .config import RobotConfig
from .recording import write_whole


def json_schema() -> dict[str, Any]:
    """JSON Schema of the robot file, with which editors complete and check it."""
    schema = RobotConfig.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schema(path: str | os.PathLike[str]) -> None:
    """Write the JSON Schema of the robot file."""
    write_whole(path, json.dumps(json_schema(), indent=2) + "\n")


if __name__ == "__main__":
    import sys

    write_schema(sys.argv[1] if len(sys.argv) > 1 else "docs/robot.schema.json")
