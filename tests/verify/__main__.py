# SPDX-License-Identifier: MIT
"""`make verify`: evidence for the C library, written to docs/verification.json and docs/verification.md.

Usage: python -m verify [STEP ...] [mutants=400] [seed=0] [minutes=30] [jobs=2] [counters=.]
       python -m verify limits      (makes the measured figures the limits of tests/verify/limits.json)

Without a STEP all are made. Results of the others stay, and the page says of which commit each one is. The status is 1
if a step failed, and 3 if none failed but one could not be evaluated.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from conftest import ROOT
from verify import analysis, coverage, fuzzing, limits, mutation
from verify.result import FAILED, MISSING, PASSED, Result
from zygos.errors import ZygosError
from zygos.files.output import counted, errors_end_the_program, note, say, write_json, write_text
from zygos.report.provenance import measured_commit

PAGE, FILE = ROOT / "docs" / "verification.md", ROOT / "docs" / "verification.json"
BEGIN, END = "<!-- make verify writes this -->\n", "<!-- to here -->"
TESTS = tuple(
    f"tests/{name}.py" if "/" in name else f"tests/unit/test_{name}.py"
    for name in (
        "any_arm bandwidth blocks c_equals_numpy change check conventions counters cycle effects flight "
        "flight_joints four_calls gains golden guard guard_joints impulse in_place integrity kinematics momentum "
        "momentum_sums motors multibody propagation range_end refine refine_beginning refine_onboard refine_upsets "
        "refiner refusals restarted_loop scrub smoother snapshot spatial tasks telemetry text torque_noise "
        "bus/test_wire"
    ).split()
)
"""The quick tests that call the library in their own process, for the mutants."""
DEFAULTS = {"mutants": "400", "seed": "0", "minutes": "30", "jobs": str(os.cpu_count() or 1), "counters": ""}
Options = Mapping[str, str]
STEPS: dict[str, Callable[[Options], Result]] = {
    "gcc": lambda _: analysis.warnings("gcc"),
    "clang": lambda _: analysis.warnings("clang"),
    "clang-tidy": lambda _: analysis.tidy(),
    "cppcheck": lambda _: analysis.cppcheck(),
    "misra": lambda _: analysis.misra(),
    "coverage": lambda given: coverage.result(given["counters"]),
    "mutation": lambda given: mutation.result(TESTS, int(given["mutants"]), int(given["seed"]), int(given["jobs"])),
    "fuzzing": lambda given: fuzzing.result(float(given["minutes"])),
    "limits-x86-64": lambda _: limits.result("x86-64"),
    "limits-m7": lambda _: limits.result("m7"),
}
"""In the order in which they are made."""
ABOUT = {
    "gcc": "warnings of gcc", "clang": "warnings of clang", "clang-tidy": "clang-tidy", "cppcheck": "cppcheck",
    "misra": "rules of MISRA C:2012 that cppcheck knows",
    "coverage": "lines and branches that the quick tests run", "mutation": "mutants that the unit tests kill",
    "fuzzing": "fuzzing", "limits-x86-64": "limits on x86-64", "limits-m7": "limits on Cortex-M7",
}  # fmt: skip
SHOWN = 20
"""Findings of a step that the page has; all are in the JSON."""


def block(content: Mapping[str, Any]) -> str:
    """The table of the page, and the findings below it."""
    rows = ["| step | evidence | verdict | figure | commit |", "|---|---|---|---|---|"]
    below = []
    for step in STEPS:
        result = content.get(step)
        if result is None:
            rows.append(f"| `{step}` | {ABOUT[step]} | **{MISSING}** | it was never run | |")
            continue
        verdict = result["verdict"] if result["verdict"] == PASSED else f"**{result['verdict']}**"
        rows.append(f"| `{step}` | {ABOUT[step]} | {verdict} | {result['figure']} | {result['commit']} |")
        if result["findings"]:
            listed = [f"- {text}" for text in result["findings"][:SHOWN]]
            rest = len(result["findings"]) - SHOWN
            listed += [f"- and {rest} more (docs/verification.json)"] if rest > 0 else []
            below.append("\n".join([f"**{step}**", "", *listed]))
    return "\n\n".join(["\n".join(rows), *below]) + "\n"


def ending(content: Mapping[str, Any], steps: Sequence[str]) -> tuple[int, str]:
    """Exit status and the last sentence of these steps: what is not evaluated is said, never left out."""
    named = {kind: [step for step in steps if _verdict(content, step) == kind] for kind in (PASSED, FAILED, MISSING)}
    text = f"verify: {counted(len(named[PASSED]), 'step')} passed"
    for kind in (FAILED, MISSING):
        if named[kind]:
            text += f"; {len(named[kind])} {kind}: {', '.join(named[kind])}"
    return 1 if named[FAILED] else 3 if named[MISSING] else 0, text


def _verdict(content: Mapping[str, Any], step: str) -> str:
    return str(content[step]["verdict"]) if step in content else MISSING


def main(*arguments: str) -> int:
    """Make the steps, write file and page. Returns the exit status."""
    if arguments == ("limits",):
        left = limits.store()
        note("".join(f"the limits of {target} stay as they are: its tools are not installed\n" for target in left))
        return 3 if left else 0
    pairs = dict(argument.split("=", 1) for argument in arguments if "=" in argument)
    steps = [argument for argument in arguments if "=" not in argument] or list(STEPS)
    for name in [*pairs, *steps]:
        if name not in (DEFAULTS if name in pairs else STEPS):
            raise ZygosError(
                f"no step or option {name!r}; remedy: steps {' · '.join(STEPS)}; options {' · '.join(DEFAULTS)}"
            )
    given = {**DEFAULTS, **pairs}
    content: dict[str, Any] = {}
    for step in steps:
        found = STEPS[step](given)
        content = json.loads(FILE.read_text()) if FILE.exists() else {}  # another step may have ended meanwhile
        content[step] = {**asdict(found), "commit": measured_commit(ROOT)}
        say(f"{step}: {found.verdict}: {found.figure}")
        for text in found.findings:
            note(f"  {text}")
        write_json(FILE, {name: content[name] for name in STEPS if name in content})
        before, rest = PAGE.read_text().split(BEGIN)
        write_text(PAGE, before + BEGIN + block(content) + END + rest.split(END)[1])
    status, text = ending(content, steps)
    note(text)
    return status


if __name__ == "__main__":
    with errors_end_the_program():
        sys.exit(main(*sys.argv[1:]))
