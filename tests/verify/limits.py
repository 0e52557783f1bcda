# SPDX-License-Identifier: MIT
"""Limits of stack, code, memory and instructions, two per cent above which `make verify` fails (limits.json)."""

from __future__ import annotations

import json
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from calls_support import Calls

from bench import cortex, flown
from bench.configurations import CONFIGURATIONS
from bench.counting import TOGETHER
from bench.footprint import LIBRARY, footprints
from conftest import ROOT
from verify.result import BUILD, FOLDER, Result, judged, missing
from zygos.files.output import write_text

LIMITS = FOLDER / "limits.json"
ALLOWED = 1.02
"""Times its limit, a figure may be."""
COUNTED = {"x86-64": ("paper, bare", "paper", "spatial"), "m7": ("paper, bare", "paper")}
"""Configurations of tests/bench whose cycles are counted. Those that are not are too slow for a check."""
CYCLES = 750
"""That are fed."""
CALLS = ("zygos.h", "wire.h", "refine.h")
"""Headers of what onboard software calls."""
STRUCTS = ("zygos_t", "zygos_background_t", "zygos_in_place_t", "zygos_estimate_t", "zygos_refine_t")


def public() -> list[str]:
    """Names of the functions that onboard software calls."""
    texts = [(ROOT / "include" / "zygos" / name).read_text() for name in CALLS]
    return sorted({name for text in texts for name in re.findall(r"^[a-z].*?\b(zygos_\w+)\(", text, re.M)})


def _structs(capacities: tuple[str, ...], folder: Path) -> dict[str, int]:
    """Bytes of the structs that the caller owns."""
    source = '#include "zygos/zygos.h"\n' + "".join(f"char of_{name}[sizeof({name})];\n" for name in STRUCTS)
    out = folder / "structs.o"
    command = ["cc", "-std=c11", *capacities, f"-I{ROOT / 'include'}", "-x", "c", "-c", "-o", str(out), "-"]
    subprocess.run(command, input=source, text=True, check=True)
    listed = subprocess.run(["nm", "-S", "-t", "d", out], capture_output=True, text=True, check=True).stdout
    return {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B of_(\w+)$", listed, re.M)}


def measured(target: str, folder: Path) -> dict[str, float]:
    """Every figure of a target that has a limit, by its name."""
    found: dict[str, float] = {}
    for name in COUNTED[target]:
        one, place = CONFIGURATIONS[name](), folder / target / name.replace(", ", "-")
        count = flown.count(target, one, CYCLES, place)
        cycles = count.stage(TOGETHER)
        found[f"instructions of the usual cycle: {name}"] = round(float(cycles[count.ordinary()].mean()), 1)
        found[f"instructions of the dearest cycle: {name}"] = int(cycles.max())
        if "bare" in name:
            continue
        found[f"instructions of zygos_work_solve(): {name}"] = int(count.tally.solve)
        size = footprints(target, place / "objects", one.capacities)
        found[f"bytes of code: {name}"] = size[LIBRARY].code
        calls = Calls(place / "objects")
        known = [call for call in public() if call in calls.calls]
        found |= {f"bytes of stack below {call}(): {name}": calls.depth(call) for call in known}
        if target == "x86-64":
            found |= {f"bytes of {struct}: {name}": size for struct, size in _structs(one.capacities, place).items()}
    return found


def exceeded(found: Mapping[str, float], limits: Mapping[str, float]) -> list[str]:
    """What is above its limit by more than is allowed, has no limit, or is not measured any more."""
    out = []
    for name, value in found.items():
        if name not in limits:
            out.append(f"{name}: {value:,} has no limit; remedy: `make limits`, and look at the difference")
        elif value > ALLOWED * limits[name]:
            out.append(
                f"{name}: {value:,} is {value / limits[name] - 1.0:+.1%} of its limit {limits[name]:,}; "
                f"remedy: save it again, or `make limits` with a reason in the commit"
            )
    return out + [f"{name}: not measured; remedy: `make limits`" for name in limits if name not in found]


def _absent(target: str) -> Result | None:
    if target == "x86-64" and platform.machine() != "x86_64":
        return Result("not evaluated", "this is no x86-64 machine", ("instructions of x86-64 need such a machine",))
    tools = {"gcc": "gcc", "valgrind": "valgrind"} if target == "x86-64" else dict.fromkeys(
        cortex.firmware.TOOLS, cortex.firmware.PACKAGES
    )  # fmt: skip
    return next((missing(tool, package) for tool, package in tools.items() if shutil.which(tool) is None), None)


def result(target: str) -> Result:
    """Measure a target and compare with its limits."""
    absent = _absent(target)
    if absent:
        return absent
    found = measured(target, BUILD / "limits")
    limits = json.loads(LIMITS.read_text()).get(target, {}) if LIMITS.exists() else {}
    lowest = {name: value / limits[name] for name, value in found.items() if limits.get(name)}
    worst = max(lowest, key=lambda name: lowest[name], default="")
    figure = f"{len(found)} figures"
    figure += f", the highest at {lowest[worst]:.1%} of its limit ({worst})" if worst else ""
    return judged(exceeded(found, limits), figure, **found)


def store() -> list[str]:
    """Measure all targets whose tools are here, and make the figures the limits. Returns the targets that are not."""
    limits = json.loads(LIMITS.read_text()) if LIMITS.exists() else {}
    left = []
    for target in COUNTED:
        if _absent(target):
            left.append(target)
        else:
            limits[target] = measured(target, BUILD / "limits")
    write_text(LIMITS, json.dumps(limits, indent=1) + "\n")
    return left
