"""What a verdict was made from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Provenance:
    """Command, version and inputs of an explanation."""

    command: str
    version: str
    files: tuple[tuple[str, str, str], ...]
    """Role, path and SHA-256 of each file that was read."""
