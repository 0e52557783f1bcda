# SPDX-License-Identifier: MIT
"""`zygos compile-model`: an arm file as a constant for onboard software, and as bytes that it can load."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.cli.options import ArmArgument, Json
from zygos.files.names import printable
from zygos.files.output import check_outputs, counted, say, table, write_json, write_text
from zygos.model.model import load_model
from zygos.native import snapshot
from zygos.native.flight import Flight, ffi, lib
from zygos.native.header import capacities, header, in_place_build, least_build, options
from zygos.native.sizes import memory

HEADER, BLOB = "arm_config.h", "arm.zyg"


def compile_model(arm_file: Path, folder: Path, model_file: Path | None, json: str | None) -> None:
    """Write the configuration of an arm; see `zygos compile-model --help`."""
    source, blob = folder / HEADER, folder / BLOB
    check_outputs([source, blob, json], [arm_file, model_file])
    arm = load_arm(arm_file)
    effects = load_model(model_file).effects if model_file else ()
    flight = Flight(arm, effects)
    columns = [effect.column(arm) for effect in flight.effects]
    omitted = [effect.column(arm) for effect in effects if effect not in flight.effects]
    made_of = " and ".join(printable(path.name) for path in (arm_file, model_file) if path)
    write_text(source, header(flight, made_of))
    snapshot.write(blob, "configuration", ffi.addressof(flight.native, "sums", "config"))
    needs = capacities(flight.native.sums.config)
    build, smaller = least_build(flight.native.sums.config), in_place_build(flight.native.sums.config)
    bytes_of, in_place = memory(build), memory(smaller, in_place=True)
    summary = {
        "arm": arm.name,
        "header": str(source),
        "blob": str(blob),
        "layout": lib.zygos_abi(),
        "full": len(arm.full_parameters),
        "base": len(arm.parameters),
        "parameters": list(flight.names),
        "units": list(flight.units),
        "effects": columns,
        "omitted": omitted,
        "capacities": needs,
        "least_build": build,
        "bytes": bytes_of,
        "in_place_build": smaller,
        "in_place_bytes": in_place,
    }
    if json:
        write_json(json, summary)
    if json != "-":
        # without a reduction the parameters are the columns, and the default holds them
        needed = {macro: str(value) for macro, value in needs.items()}
        needed |= {} if needs["ZYGOS_MAX_PARAMETERS"] else {"ZYGOS_MAX_PARAMETERS": "default"}
        rows = [(macro, value, str(getattr(lib, f"{macro}_VALUE"))) for macro, value in needed.items()]
        table(("capacity", "needed", f"{BLOB} has"), rows)
        listed = [*bytes_of.items(), ("in all", sum(bytes_of.values()))]
        table(("memory of the smallest build", "bytes"), [(what, f"{size:,}") for what, size in listed])
        say(f"options of this build: {options(build)}")
        listed = [*in_place.items(), ("in all", sum(in_place.values()))]
        table(("with the fewest blocks, solved in place", "bytes"), [(what, f"{size:,}") for what, size in listed])
        say(f"options of this build: {options(smaller)}")
        say(
            f"{source}, {blob}: arm {arm.name}, {counted(arm.n, 'joint')}, "
            f"{counted(len(arm.parameters), 'base parameter')} of {len(arm.full_parameters)}, "
            f"{counted(len(flight.effects), 'effect')}, layout 0x{lib.zygos_abi():08X}"
        )
        if omitted:
            say(f"not estimated on board, because the balance does not need it: {', '.join(omitted)}")


def command(
    arm: ArmArgument,
    out: Annotated[
        Path,
        typer.Option("-o", "--out", metavar="FOLDER", help="The folder where arm_config.h and arm.zyg are written."),
    ] = Path(),
    model: Annotated[
        Path | None, typer.Option("--model", metavar="PRIOR.toml", help="Also estimate the effects of this model.")
    ] = None,
    json: Json = None,
) -> None:
    """Compile an arm file into a constant that onboard software links, and into bytes that it loads.

    Writes arm_config.h, for C11 and C++17, with the configuration and the indices of the parameters (ARM_k1), and
    arm.zyg, the bytes of the same configuration in this build after a header with layout and CRC (docs/snapshot.md),
    which `zygos-node` loads. A configuration that the flight library would refuse is not written, nor one of a model
    with effects that the library has no columns for.

    Example: zygos compile-model examples/paper/arm.toml -o out/onboard
    """
    compile_model(arm, out, model, json)
