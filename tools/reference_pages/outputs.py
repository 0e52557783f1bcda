# SPDX-License-Identifier: MIT
"""The page of the JSON outputs, from their schemas."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from reference_pages.markdown import page, table

SCHEMAS = Path(__file__).resolve().parents[2] / "docs" / "reference" / "schemas"


def schemas() -> dict[str, Any]:
    """The schemas by their names."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(SCHEMAS.glob("*.json"))}


def _type(schema: Any) -> str:
    if "const" in schema or "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema.get("enum", [schema.get("const")]))
    named = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    inner = schema.get("items", {}).get("type")
    each = inner if isinstance(inner, str) else "number"
    return " or ".join(f"array of {each}s" if name == "array" else str(name) for name in named)


def _unit(schema: Any) -> str:
    """The unit of a schema, or of the numbers in its arrays and in its maps of plain values."""
    for inner in ("items", "additionalProperties"):
        if "unit" not in schema and isinstance(schema.get(inner), dict):
            return _unit(schema[inner])
    return str(schema.get("unit", ""))


def flat(schema: Any, path: str = "") -> Iterable[tuple[str, str, str, str]]:
    """Each key of a schema with type, unit and meaning. [] stands for the entries of an array, NAME for any name."""
    for key, inner in schema.get("properties", {}).items():
        name = f"{path}.{key}" if path else key
        yield f"`{name}`", _type(inner), _unit(inner), inner["description"]
        yield from flat(inner, name)
    if "items" in schema:
        yield from flat(schema["items"], f"{path}[]")
    if isinstance(schema.get("additionalProperties"), dict):
        yield from flat(schema["additionalProperties"], f"{path}.NAME")


def json_page() -> str:
    """The page of the JSON outputs."""
    parts = []
    for name, schema in schemas().items():
        parts.append(f"## {schema['title']}")
        parts.append(f"Schema: [schemas/{name}.json](schemas/{name}.json)")
        parts.append(table(("Key", "Type", "Unit", "Meaning"), flat(schema)))
    intro = (
        "Every JSON output has a JSON Schema (draft 2020-12) in [schemas](schemas/). A number that does not exist, "
        "such as the value of a parameter that is not identifiable, is null. In the tables `[]` stands for the "
        "entries of an array, and `NAME` for the names of parameters, joints or messages. The unit 1 means that a "
        "number has no unit. In the schemas the keyword `unit` holds the unit of a number, and `commands` the "
        "commands that write the output."
    )
    return page("JSON outputs", intro, *parts)
