# SPDX-License-Identifier: MIT
"""Warnings of two compilers, clang-tidy and cppcheck over the C library, and rules of MISRA C:2012."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from conftest import ROOT
from verify.result import FOLDER, Result, entries, judged, missing, sources
from zygos.files.output import counted

MORE = {
    "gcc": "-Wcast-qual -Wcast-align=strict -Wstrict-prototypes -Wmissing-prototypes -Wwrite-strings -Wundef "
    "-Wformat=2 -Wswitch-enum -Wvla -Walloca -Wpointer-arith -Winit-self -Wredundant-decls -Wnested-externs "
    "-Wfloat-equal -Wnull-dereference -Wlogical-op -Wduplicated-cond -Wduplicated-branches -Warith-conversion "
    "-Wstrict-overflow=2 -Wtrampolines",
    # Declarations after statements are C11; padding is checked by assertions in the headers; a function's result is
    # converted on purpose.
    "clang": "-Weverything -Wno-unknown-warning-option -Wno-declaration-after-statement -Wno-padded "
    "-Wno-bad-function-cast -Wno-unsafe-buffer-usage -Wno-switch-default -Wno-pre-c11-compat",
}
"""Warnings beside those of c/flags.txt."""
CAPACITIES = (
    (),
    ("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0", "-DZYGOS_MOMENTUM=0", "-DZYGOS_JOINT_ROWS=0"),
    ("-DZYGOS_MAX_JOINTS=3",),
)
"""Builds whose code differs: what is left out must leave no warning either."""
INCLUDE = f"-I{ROOT / 'include'}"
ACCEPTED = FOLDER / "accepted.toml"
TIDY = FOLDER / "clang-tidy.yaml"
SILENT = FOLDER / "cppcheck.txt"
DEVIATIONS = FOLDER / "misra.txt"
_RULE = "misra-c2012-"


@dataclass(frozen=True)
class Finding:
    """A message of a tool about a line."""

    path: Path
    line: int
    text: str
    check: str

    def __str__(self) -> str:
        return f"{self.path.name}:{self.line}: {self.text} [{self.check}]"


def found_in(text: str) -> list[Finding]:
    """The messages in what gcc, clang, clang-tidy or cppcheck print, each one once."""
    kinds = "warning|error|style|performance|portability|information"
    pattern = rf"^(\S+?):(\d+):(?:\d+:)? (?:\w+ )?(?:{kinds}): (.*) \[([^\[\]]+)\]$"
    rows = re.findall(pattern, text, re.M)
    return list(dict.fromkeys(Finding(Path(path), int(line), what, check) for path, line, what, check in rows))


def left(findings: Iterable[Finding], accepted: Path) -> list[str]:
    """The findings that are not accepted, as text: an entry accepts one finding of its check in its file."""
    free = Counter((entry["check"], entry["file"]) for entry in entries(accepted, "check", "file", "reason"))
    out = []
    for finding in findings:
        key = next(((c, finding.path.name) for c in finding.check.split(",") if free[c, finding.path.name] > 0), None)
        if key is None:
            out.append(str(finding))
        else:
            free[key] -= 1
    return out


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def _errors(done: subprocess.CompletedProcess[str], command: Sequence[str]) -> list[str]:
    """What a failed tool says that is no message about a line."""
    if done.returncode == 0 or found_in(done.stdout + done.stderr):
        return []
    return [f"{command[0]} failed with status {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}"]


def warnings(compiler: str, files: Sequence[Path] | None = None) -> Result:
    """Compile every file with the house flags, more warnings and -Werror, at three sets of capacities."""
    if shutil.which(compiler) is None:
        return missing(compiler, compiler)
    flags = [*shlex.split((ROOT / "c" / "flags.txt").read_text()), *shlex.split(MORE[compiler]), "-Werror", INCLUDE]
    files = sources() if files is None else files
    commands = [
        [compiler, *flags, *capacities, "-c", str(path), "-o", os.devnull]
        for capacities in CAPACITIES
        for path in files
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(_run, commands))
    findings = found_in("".join(done.stderr for done in runs))
    broken = [text for done, command in zip(runs, commands, strict=True) for text in _errors(done, command)]
    count = len(findings) + len(broken)
    figure = f"{counted(count, 'warning')} in {counted(len(files), 'file')} at {len(CAPACITIES)} sets of capacities"
    return judged([*map(str, findings), *broken], figure, warnings=count)


def tidy(files: Sequence[Path] | None = None, tool: str = "clang-tidy") -> Result:
    """Every file under the checks of clang-tidy.yaml."""
    if shutil.which(tool) is None:
        return missing(tool, "clang-tidy")
    files = sources() if files is None else files
    commands = [
        [tool, "--quiet", f"--config-file={TIDY}", str(path), "--", "-std=c11", "-ffp-contract=off", INCLUDE]
        for path in files
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(_run, commands))
    found = list(dict.fromkeys(one for done in runs for one in found_in(done.stdout)))
    broken = [text for done, command in zip(runs, commands, strict=True) for text in _errors(done, command)]
    return _accounted(found, broken, files)


def cppcheck(files: Sequence[Path] | None = None, tool: str = "cppcheck") -> Result:
    """All checks of cppcheck but those of cppcheck.txt, at every set of capacities that the headers know."""
    if shutil.which(tool) is None:
        return missing(tool, "cppcheck")
    files = sources() if files is None else files
    command = [
        tool, "--enable=all", "--inconclusive", "--std=c11", "--platform=unix64", "-q", INCLUDE,
        f"--suppressions-list={SILENT}", "--template={file}:{line}: {severity}: {message} [{id}]",
        *map(str, files),
    ]  # fmt: skip
    done = _run(command)
    return _accounted(found_in(done.stderr), _errors(done, command), files)


def misra(files: Sequence[Path] | None = None, tool: str = "cppcheck", deviations: Path = DEVIATIONS) -> Result:
    """The rules of MISRA C:2012 that cppcheck's addon knows, at the usual capacities, but those of misra.txt.

    A rule of misra.txt that nothing breaks is a finding too, where all files are read.
    """
    if shutil.which(tool) is None:
        return missing(tool, "cppcheck")
    template = "--template={file}:{line}: {severity}: {message} [{id}]"
    flags = ["--addon=misra", "--std=c11", "--platform=unix64", "--max-configs=1", "-q", INCLUDE, template]
    commands = [[tool, *flags, str(path)] for path in (sources() if files is None else files)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        runs = list(pool.map(_run, commands))
    found = [one for one in found_in("".join(done.stderr for done in runs)) if one.check.startswith(_RULE)]
    broken = [text for done, command in zip(runs, commands, strict=True) for text in _errors(done, command)]
    lines = [line.split(maxsplit=1) for line in deviations.read_text().splitlines() if not line.startswith("#")]
    rules = {rule: reason for rule, reason in lines}
    count = Counter(one.check.removeprefix(_RULE) for one in found)
    open_ones = [f"{one.path.name}:{one.line}: rule {rule}" for one in found
                 if (rule := one.check.removeprefix(_RULE)) not in rules]  # fmt: skip
    idle = [f"{deviations.name}: nothing breaks rule {rule}; remedy: remove it" for rule in rules if rule not in count]
    idle = idle if files is None else []
    deviating = sum(count[rule] for rule in rules)
    figure = f"{counted(len(open_ones), 'open finding')}, {deviating} of {len(rules)} rules that are left out"
    return judged([*open_ones, *idle, *broken], figure, open=len(open_ones), deviations=deviating)


def _accounted(found: Sequence[Finding], broken: Sequence[str], files: Sequence[Path]) -> Result:
    open_ones = left(found, ACCEPTED)
    accepted = len(found) - len(open_ones)
    figure = f"{counted(len(open_ones), 'open finding')}, {accepted} accepted with a reason, in {len(files)} files"
    return judged([*open_ones, *broken], figure, open=len(open_ones), accepted=accepted)
