# SPDX-License-Identifier: MIT
"""`zygos dbc`: writes the DBC of one arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cantools.database.utils import sort_signals_by_start_bit

from zygos.arm import load_arm
from zygos.can.dbc import arm_database, joint_names
from zygos.cli.options import Json
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, counted, is_dash, quiet, say, table, write_json, write_text
from zygos.model.model import load_model


def write_dbc(arm_file: Path, model_file: Path | None, out: Path, json: str | None) -> None:
    """Write the DBC of an arm; see `zygos dbc --help`."""
    if not is_dash(out) and out.suffix.lower() != ".dbc":
        raise ZygosError(f"{out}: not a name for a DBC; remedy: give it the suffix .dbc")
    check_outputs([out, json], [arm_file, model_file])
    arm = load_arm(arm_file)
    content = arm_database(arm, load_model(model_file).effects if model_file else ())
    write_text(out, content.as_dbc_string(sort_signals=sort_signals_by_start_bit))
    if json:
        listed = [
            {
                "name": message.name,
                "id": message.frame_id,
                "bytes": message.length,
                "sender": message.senders[0],
                "cycle_ms": message.cycle_time,
                "signals": [signal.name for signal in message.signals],
            }
            for message in content.messages
        ]
        joints = {joint.name: name for joint, name in zip(arm.joints, joint_names(arm), strict=True)}
        write_json(json, {"dbc": str(out), "arm": arm.name, "joints": joints, "messages": listed})
    if not quiet(out, json):
        table(
            ("message", "identifier", "bytes", "sender", "every", "signals"),
            [
                (
                    message.name,
                    f"0x{message.frame_id:03X}",
                    str(message.length),
                    message.senders[0],
                    f"{message.cycle_time} ms",
                    str(len(message.signals)),
                )
                for message in content.messages
            ],
        )
        say(f"{out}: arm {arm.name}, {counted(len(content.messages), 'message')}")


def command(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="ARM.dbc", help="The DBC to write.")],
    model: Annotated[
        Path | None, typer.Option("--model", metavar="PRIOR.toml", help="Also include the effects of this model.")
    ] = None,
    json: Json = None,
) -> None:
    """Write the DBC of this arm, for any CAN tool: its frames, with the joints' and parameters' names.

    A joint's name becomes an identifier of at most 20 letters, digits and underscores. If two joints would have the
    same identifier, all of them end in their node numbers.

    Example: zygos dbc --arm examples/paper/arm.toml -o out/arm.dbc
    """
    write_dbc(arm, model, out, json)
