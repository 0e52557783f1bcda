# SPDX-License-Identifier: MIT
"""What a step of `make verify` finds: a verdict, a figure for the table, and the findings."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT
from zygos.errors import ZygosError

PASSED, FAILED, MISSING = "passed", "failed", "not evaluated"
FOLDER = Path(__file__).parent
BUILD = ROOT / "build" / "verify"


@dataclass(frozen=True)
class Result:
    """The outcome of one step."""

    verdict: str
    """PASSED, FAILED, or MISSING where a tool is not installed."""
    figure: str
    """One line for the table."""
    findings: tuple[str, ...] = ()
    """What has to be repaired or installed, a sentence each."""
    figures: dict[str, Any] | None = None
    """Numbers for the JSON file."""


def missing(tool: str, package: str) -> Result:
    """The result of a step whose tool is not installed."""
    return Result(MISSING, f"{tool} is not installed", (f"{tool} is not installed; remedy: apt install {package}",))


def judged(findings: Iterable[str], figure: str, **figures: Any) -> Result:
    """FAILED if there is a finding, otherwise PASSED."""
    listed = tuple(findings)
    return Result(FAILED if listed else PASSED, figure, listed, figures)


def sources(checkout: Path = ROOT) -> list[Path]:
    """The files of the library."""
    return sorted((checkout / "c").glob("*/*.c"))


def digest(checkout: Path = ROOT) -> str:
    """Short digest of the library and its headers, which says of which state a result is."""
    total = hashlib.sha256()
    headers = sorted((checkout / "include" / "zygos").rglob("*.h"))
    for path in [*sources(checkout), *headers, checkout / "c" / "flags.txt"]:
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()[:12]


def entries(path: Path, *keys: str) -> list[dict[str, Any]]:
    """The tables [[entry]] of a TOML file, each of which has the keys. Errors: ZygosError."""
    try:
        found: list[dict[str, Any]] = tomllib.loads(path.read_text()).get("entry", [])
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ZygosError(f"{path.name}: {error}; remedy: repair the file") from error
    for number, entry in enumerate(found, start=1):
        lacking = [key for key in keys if not entry.get(key)]
        if lacking:
            raise ZygosError(f"{path.name}: entry {number} has no {lacking[0]!r}; remedy: write it")
    return found
