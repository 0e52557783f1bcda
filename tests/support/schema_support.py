# SPDX-License-Identifier: MIT
"""Every JSON that a command writes in a test is held against its schema (docs/reference/schemas)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from zygos import cli
from zygos.files import output

SCHEMAS = {
    path.stem: json.loads(path.read_text())
    for path in (Path(__file__).resolve().parents[2] / "docs" / "reference" / "schemas").glob("*.json")
}
OF_ESTIMATOR = {schema["estimator"]: name for name, schema in SCHEMAS.items() if "estimator" in schema}
"""Schemas of a command with several kinds of answers, by the estimator that an answer names."""
OF_COMMAND = {command: name for name, schema in SCHEMAS.items() for command in schema["commands"]}


def hold(name: str, content: Any) -> None:
    """Fail where a content does not match the schema of that name."""
    wrong = [
        f"{'.'.join(map(str, error.absolute_path)) or 'at the top'}: {error.message}"
        for error in Draft202012Validator(SCHEMAS[name]).iter_errors(content)
    ]
    assert not wrong, f"docs/reference/schemas/{name}.json: " + "; ".join(wrong[:5])


@pytest.fixture(scope="session", autouse=True)
def json_matches_schema() -> Iterator[set[str]]:
    """The commands whose JSON has matched its schema so far."""
    running, held = [""], set[str]()
    load, module = cli.load, output.json

    def loaded(name: str) -> Any:
        command = load(name)
        invoke = command.invoke

        def invoked(context: Any) -> Any:
            running.append(name)
            try:
                return invoke(context)
            finally:
                running.pop()

        command.invoke = invoked  # type: ignore[method-assign]
        return command

    def dumps(content: Any, **options: Any) -> str:
        text = module.dumps(content, **options)
        if running[-1]:
            written = json.loads(text)
            hold(OF_ESTIMATOR.get(written.get("estimator"), OF_COMMAND[running[-1]]), written)
            held.add(running[-1])
        return text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "load", loaded)
        patch.setattr(output, "json", SimpleNamespace(dumps=dumps))
        yield held
