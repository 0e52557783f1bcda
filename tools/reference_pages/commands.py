# SPDX-License-Identifier: MIT
"""The page of the command line: every command with its arguments and options."""

import inspect
from typing import Any

from reference_pages.markdown import page, table
from zygos.cli import GROUPS, load


def commands_page() -> str:
    """Every command of `zygos`, in the order and the groups of `zygos --help`."""
    parts = ["What `zygos COMMAND --help` says. `-h` is `--help`, and `zygos --version` prints the version."]
    for group, commands in GROUPS.items():
        parts.append(f"## {group}")
        for name in commands:
            described = load(name)
            shown: list[Any] = [one for one in described.params if not getattr(one, "hidden", False)]
            arguments = [one for one in shown if one.param_type_name == "argument"]
            options = [one for one in shown if one.param_type_name != "argument"]
            needed = [f"{one.opts[-1]} {_metavar(one)}".strip() for one in options if one.required]
            lines = [(f"`{_named(one)}`", _help(one)) for one in arguments]
            for one in options:
                said = " ".join([", ".join([*one.opts, *one.secondary_opts]), _metavar(one)])
                lines.append((f"`{said.strip()}`", _help(one)))
            parts += [
                f"### zygos {name}",
                f"    {' '.join([f'zygos {name}', *map(_named, arguments), *needed, '[OPTIONS]'])}",
                inspect.cleandoc(str(described.help)),
                table(("argument or option", "meaning"), lines),
            ]
    return page("Command line", *parts)


def _named(argument: Any) -> str:
    name = str(argument.metavar or argument.name.upper())
    return name if argument.required else f"[{name}]"


def _metavar(option: Any) -> str:
    return "" if option.is_flag else str(option.metavar or "")


def _help(one: Any) -> str:
    return " ".join(str(one.help or "").split())
