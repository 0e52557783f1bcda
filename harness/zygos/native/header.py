# SPDX-License-Identifier: MIT
"""`zygos compile-model`: an arm file as the constant that onboard software links, and as bytes that it loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from zygos.files.names import ascii_name, printable
from zygos.native import flight as library
from zygos.native.flight import Flight
from zygos.native.sizes import memory

_ENUMS = {
    "kinetic": "zygos_kinetic",
    "torque_law": "zygos_torque_law",
    "base": "zygos_base",
    "kind": "zygos_effect_kind",
}
"""Fields that hold a value of an enumeration."""


_PROPOSED = {"ZYGOS_MAX_BLOCKS": 12, "ZYGOS_MAX_MOTOR_BLOCKS": 8, "ZYGOS_MAX_MOMENTUM_BLOCKS": 8}
"""Blocks of a build for onboard software, with which the sigmas are as large on average as with the defaults."""
_FEWEST = {"ZYGOS_MAX_BLOCKS": 11, "ZYGOS_MAX_MOTOR_BLOCKS": 4, "ZYGOS_MAX_MOMENTUM_BLOCKS": 4}
"""The least of a build."""
_COUNTED = {"joint": "joints", "effect": "effects", "reduction": "reductions"}
"""Arrays of which only so many entries are in use."""


def capacities(config: Any) -> dict[str, int]:
    """The least capacity, by macro, that a build needs for a ``zygos_config_t *``."""
    return {
        "ZYGOS_MAX_JOINTS": max(config.joints, (config.compensation - 2) // 2),
        "ZYGOS_MAX_HALF_WIDTH": config.smoother_half_width,
        "ZYGOS_MAX_EFFECTS": config.effects,
        "ZYGOS_MAX_REDUCTION": config.reductions,
        "ZYGOS_MAX_PARAMETERS": _parameters(config),
        "ZYGOS_SPATIAL": int(config.kinetic == library.lib.ZYGOS_SPATIAL_ARM),
        "ZYGOS_MOMENTUM": int(config.momentum_arc_cycles > 0),
        "ZYGOS_JOINT_ROWS": int(config.joint_row_cycles > 0),
    }


def _parameters(config: Any) -> int:
    """Number of parameters, with those of the effects."""
    reduced = config.reduced + config.effects
    return int(reduced if config.reduced > 0 else library.lib.zygos_balance_columns(library.ffi.addressof(config)))


def least_build(config: Any) -> dict[str, int]:
    """The capacities of the smallest build that holds a ``zygos_config_t`` and has every function, by macro; the
    others are the defaults."""
    needs = capacities(config) | _PROPOSED
    if library.lib.zygos_joint_sums_suffice(library.ffi.addressof(config)):
        needs["ZYGOS_MAX_BLOCKS"] = _FEWEST["ZYGOS_MAX_BLOCKS"]
    if config.impulse_arc_cycles == 0:
        needs["ZYGOS_MAX_MOTOR_BLOCKS"] = _FEWEST["ZYGOS_MAX_MOTOR_BLOCKS"]
    # fewer are no build
    needs["ZYGOS_MAX_PARAMETERS"] = max(needs["ZYGOS_MAX_PARAMETERS"], 2 * needs["ZYGOS_MAX_JOINTS"] + 3)
    return needs


def in_place_build(config: Any) -> dict[str, int]:
    """The same with the fewest blocks of all rows: what a flight computer needs that solves in place."""
    needs = least_build(config) | _FEWEST
    return {name: value for name, value in needs.items() if config.momentum_arc_cycles or "MOMENTUM_BLOCKS" not in name}


def options(build: dict[str, int]) -> str:
    """Capacities as options of a compiler."""
    return " ".join(f"-D{macro}={value}" for macro, value in build.items())


def _initialiser(value: Any, field: str) -> str:
    """A value of C as source: numbers exactly, with the name of an enumeration's."""
    if isinstance(value, float):
        return repr(value)  # the shortest number that reads back as the same
    if field in _ENUMS:
        names: dict[int, str] = library.ffi.typeof(f"enum {_ENUMS[field]}").elements
        return names[value]
    return "ZYGOS_ABI" if field == "abi" else f"{value}u"


def _fields(struct: Any, indent: str) -> Iterator[str]:
    """Lines that initialise the fields of a struct in their order."""
    for field, kind in library.ffi.typeof(struct).fields:
        value = getattr(struct, field)
        if kind.type.kind != "array":
            yield f"{indent}.{field} = {_initialiser(value, field)},"
        elif kind.type.item.kind != "struct":
            yield f"{indent}.{field} = {{ {', '.join(_initialiser(entry, field) for entry in value)} }},"
        else:
            yield f"{indent}.{field} = {{"
            for entry in list(value)[: max(1, getattr(struct, _COUNTED[field]))]:
                yield f"{indent}    {{"
                yield from _fields(entry, indent + "        ")
                yield f"{indent}    }},"
            yield f"{indent}}},"


def header(flight: Flight, source: str) -> str:
    """The text of arm_config.h for an arm that the library has accepted. source: what it was made of."""
    config = flight.native.sums.config
    parameters = [
        f"    ARM_{ascii_name(name)} = {k}, // {unit}"
        for k, (name, unit) in enumerate(zip(flight.names, flight.units, strict=True))
    ]
    least = [
        f"#if {macro} < {value}\n"
        f'#error "this arm needs {macro} {value}; remedy: compile with -D{macro}={value}"\n'
        "#endif"
        for macro, value in capacities(config).items()
        if value > 0
    ]
    build, smaller = least_build(config), in_place_build(config)
    bytes_of, in_place = memory(build), memory(smaller, in_place=True)
    version = library.lib.ZYGOS_VERSION_MAJOR_VALUE, library.lib.ZYGOS_VERSION_MINOR_VALUE
    return "\n".join(
        [
            f"// Arm {printable(flight.arm.name)}, compiled from {source} by `zygos compile-model`. Do not edit.",
            "//",
            f"// The smallest build that holds it: {options(build)}",
            f"// It takes {sum(bytes_of.values()):,} bytes: "
            + ", ".join(f"{what} {size:,}" for what, size in bytes_of.items())
            + ".",
            "//",
            f"// With the fewest blocks: {options(smaller)}",
            f"// With a zygos_in_place_t it takes {sum(in_place.values()):,} bytes: "
            + ", ".join(f"{what} {size:,}" for what, size in in_place.items())
            + ".",
            "",
            "#ifndef ARM_CONFIG_H",
            "#define ARM_CONFIG_H",
            "",
            '#include "zygos/zygos.h"',
            "",
            f"#if (ZYGOS_VERSION_MAJOR != {version[0]}) || (ZYGOS_VERSION_MINOR != {version[1]})",
            '#error "written for another version of zygos; remedy: run `zygos compile-model` again"',
            "#endif",
            *least,
            "",
            "/// Where the estimate has each parameter: estimate.value[ARM_k1].",
            "enum arm_parameter {",
            *parameters,
            f"    ARM_PARAMETERS = {len(parameters)}",
            "};",
            "",
            "#ifdef __cplusplus",
            "#pragma GCC system_header // no warning: C++17 compilers know the designated initialisers of C and C++20",
            "#endif",
            "",
            "/// What zygos_init() is given.",
            "static const zygos_config_t arm_config = {",
            *_fields(config, "    "),
            "};",
            "",
            "#endif",
            "",
        ]
    )
