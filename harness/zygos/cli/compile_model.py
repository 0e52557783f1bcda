"""`zygos compile-model`: an arm file as a constant for onboard software, and as bytes that it can load."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.cli.options import Json
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.files.names import printable
from zygos.files.output import check_outputs, counted, say, table, write_json, write_text
from zygos.model.model import load_model
from zygos.native import snapshot
from zygos.native.flight import Flight, ffi, flies, lib
from zygos.native.header import capacities, header

HEADER, BLOB = "arm_config.h", "arm.zyg"


def compile_model(arm_file: Path, folder: Path, model_file: Path | None, json: str | None) -> None:
    """Write the configuration of an arm; see `zygos compile-model --help`."""
    source, blob = folder / HEADER, folder / BLOB
    check_outputs([source, blob, json], [arm_file, model_file])
    arm = load_arm(arm_file)
    effects = load_model(model_file).effects if model_file else ()
    refuse_unflown(effects, model_file)
    flight = Flight(arm, effects)
    columns = [effect.column(arm) for effect in flight.effects]
    omitted = [effect.column(arm) for effect in effects if effect not in flight.effects]
    made_of = " and ".join(printable(path.name) for path in (arm_file, model_file) if path)
    write_text(source, header(flight, made_of))
    snapshot.write(blob, "configuration", ffi.addressof(flight.native, "config"))
    needs = capacities(flight.native.config)
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
    }
    if json:
        write_json(json, summary)
    if json != "-":
        rows = [(macro, str(value), str(getattr(lib, f"{macro}_VALUE"))) for macro, value in needs.items()]
        table(("capacity", "needed", f"{BLOB} has"), rows)
        say(
            f"{source}, {blob}: arm {arm.name}, {counted(arm.n, 'joint')}, "
            f"{counted(len(arm.parameters), 'base parameter')} of {len(arm.full_parameters)}, "
            f"{counted(len(flight.effects), 'effect')}, layout 0x{lib.zygos_abi():08X}"
        )
        if omitted:
            say(f"not estimated on board, because the balance does not need it: {', '.join(omitted)}")


def refuse_unflown(effects: Sequence[Effect], model_file: Path | None) -> None:
    """Refuse a model with effects that the flight library has no columns for, naming them all."""
    lacking = [effect for effect in effects if not flies(effect.kind)]
    if not lacking:
        return
    listed = [f"{effect.kind.key}{f' at {effect.joint}' if effect.joint else ''}" for effect in lacking]
    one = len(lacking) == 1
    raise ZygosError(
        f"{model_file}: the flight library has no column for {', '.join(listed)}; remedy: remove "
        f"{'this entry' if one else 'these entries'} from a copy of the model and compile that. The estimate on board "
        f"then lacks {'this effect' if one else 'these effects'}, and parameters that resemble "
        f"{'it' if one else 'them'} are biased"
    )


def command(
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
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
