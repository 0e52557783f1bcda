# SPDX-License-Identifier: MIT
"""Stored configurations and states: memory of the C library behind a head with layout and CRC (docs/snapshot.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from zygos.errors import ZygosError
from zygos.files.output import write_bytes
from zygos.native.flight import Flight, ffi, lib, text_of

SnapshotKind = Literal["configuration", "state"]
_KINDS: dict[SnapshotKind, tuple[int, str]] = {
    "configuration": (lib.ZYGOS_SNAPSHOT_CONFIG, "zygos_config_t"),
    "state": (lib.ZYGOS_SNAPSHOT_STATE, "zygos_arm_t"),
}
_HEAD = lib.ZYGOS_SNAPSHOT_HEAD_VALUE
_REMEDIES = {
    lib.ZYGOS_E_SNAPSHOT: "check the path",
    lib.ZYGOS_E_FORMAT: "use the version that wrote it",
    lib.ZYGOS_E_KIND: "check the path",
    lib.ZYGOS_E_BYTE_ORDER: "read it on such a machine",
    lib.ZYGOS_E_LAYOUT: "write it again with this",
    lib.ZYGOS_E_LENGTH: "copy it again",
    lib.ZYGOS_E_CRC: "copy or write it again",
    lib.ZYGOS_E_STATE: "take an older one",
    lib.ZYGOS_E_SUMS: "take an older one",
    lib.ZYGOS_E_CONFIG: "give the configuration that it was made with",
}


def refusal(path: str | Path, kind: SnapshotKind, code: int) -> ZygosError:
    """The error for what `zygos_snapshot_check` or `zygos_arm_resume` answers."""
    wrong = text_of(lib.zygos_text, code) if code in _REMEDIES else f"is refused with code {code}"
    if code == lib.ZYGOS_E_KIND:
        wrong = f"is a snapshot of something else, no {kind}"
    return ZygosError(f"{path}: {wrong}; remedy: {_REMEDIES.get(code, 'write it again')}")


def seal(kind: SnapshotKind, native: Any) -> bytes:
    """Head and memory of a ``zygos_config_t *`` or ``zygos_arm_t *``."""
    number, _ = _KINDS[kind]
    head = ffi.new("uint8_t[]", _HEAD)
    lib.zygos_snapshot_seal(number, native, head)
    return bytes(head) + bytes(ffi.buffer(native))


def read(path: str | Path, kind: SnapshotKind) -> Any:
    """The ``zygos_config_t *`` or ``zygos_arm_t *`` of a file.

    Errors: ZygosError if there is none, or it is not exactly what this build of the library would have sealed.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ZygosError(f"{path}: cannot be read ({error.strerror}); remedy: check the path") from None
    number, struct = _KINDS[kind]
    image = content[_HEAD:]
    verdict = lib.zygos_snapshot_check(number, content[:_HEAD], ffi.from_buffer(image), len(content))
    if verdict < 0:
        raise refusal(path, kind, verdict)
    native = ffi.new(f"{struct} *")
    ffi.memmove(native, image, len(image))
    return native


def write(path: Path, kind: SnapshotKind, native: Any) -> None:
    """Seal into a file, which is written whole or not at all. Errors: ZygosError if it cannot be written."""
    write_bytes(path, seal(kind, native))


def resume(flight: Flight, path: str | Path) -> None:
    """Let an estimator go on where a stored state ended.

    Errors: as `read`, and for another configuration, or counts and sums that memory errors had changed.
    """
    state = read(path, "state")
    config = ffi.addressof(flight.native, "sums", "config")
    verdict = lib.zygos_arm_check(state, config, ffi.new("zygos_work_t *"))
    if verdict == 1:
        verdict = lib.zygos_arm_resume(state, config)
    if verdict < 0:
        raise refusal(path, "state", verdict)
    flight.native = state
