# SPDX-License-Identifier: MIT
"""From CAN frames to cycles over a whole log (docs/wire.md, "Assembly").

The layout comes from `zygos.dbc` through cantools, the check of the header from the package `autosar-e2e` of PyPI. A
log is evaluated as a whole: first each frame alone, then the SYNCs, then the frames between two SYNCs together. Receive
times are not used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from cantools.database.can import Message
from e2e.p02 import e2e_p02_check

from zygos.arm import Arm
from zygos.can.wire import BUS_OFF, ERROR, SYNC_MODULUS, UNWANTED, Frame, MessageKind, data_ids, identifiers
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles

MAX_CYCLES_WITHOUT_TIME = 120


LATCH_TOLERANCE_US = 50


STATUS_FAULTS = (("disabled", 8), ("link_invalid", 1), ("motor_invalid", 2), ("torque_invalid", 4))
"""Faults that a joint's frame reports by a status bit of 0, in the order of priority: only one is counted per frame."""


@dataclass(frozen=True)
class Reception:
    """Complete cycles of a log, and the number of occurrences of each fault.

    cycles: as reported by the sensors. faults: count by name, the names those of `zygos_faults_t`; absent means never.
    verdicts: "foreign", "accepted" or "rejected" for each frame.
    """

    cycles: Cycles
    faults: Counter[str]
    verdicts: tuple[str, ...]


class _Seen(NamedTuple):
    """A frame that is well formed on its own. raw: codes of its signals. value: their physical values."""

    at: int
    kind: MessageKind
    raw: dict[str, int]
    value: dict[str, float]


class _Log:
    """Verdicts and faults of one log; every frame is initially foreign."""

    def __init__(self, count: int) -> None:
        self.faults: Counter[str] = Counter()
        self.verdicts = ["foreign"] * count

    def accept(self, at: int) -> None:
        self.verdicts[at] = "accepted"

    def reject(self, at: int, fault: str) -> None:
        self.verdicts[at] = "rejected"
        self.faults[fault] += 1


def receive_log(arm: Arm, frames: Iterable[Frame]) -> Reception:
    """Evaluate a whole log in the order of the bus. The last cycle, which no SYNC closes, is left out.

    A cycle is used if each of its frames came exactly once, valid and with the counter of its SYNC. The cycle number
    counts SYNCs modulo 240 from the first one, which is 0; BREAK_BEFORE marks the first cycle used after an
    interruption that the numbers do not show, VOID_BEFORE the first one used after FTIME showed that cycles are
    missing.
    """
    frames = list(frames)
    log = _Log(len(frames))
    seen, bus_off = _each_frame(arm, frames, log)
    syncs = [s for s in seen if s.kind.family is None]
    numbers, opens, repeated = _cycles_of(syncs, log)
    n = len(opens)

    slots: list[list[_Seen]] = [[] for _ in range(n)]
    others = [s for s in seen if s.kind.family is not None]
    for s, slot in zip(others, np.searchsorted(opens, [s.at for s in others]) - 1, strict=True):
        if slot < 0:
            log.reject(s.at, "unsynced")
        else:
            slots[slot].append(s)

    counters = [frames[at].data[0] for at in opens]
    used: list[int] = []
    contents: list[dict[str, _Seen]] = []
    parts = {kind.part for kind in identifiers(arm).values()} - {None, UNWANTED}
    for slot, counter in enumerate(counters):
        content, sound = _judge(arm, slots[slot], counter, log)
        if slot == n - 1:
            continue
        complete = set(content) == parts
        log.faults["incomplete"] += not complete
        if complete and sound and slot not in repeated:
            used.append(slot)
            contents.append(content)
        else:
            log.faults["dropped"] += 1

    breaks = {0} | {slot for slot in range(1, n) if numbers[slot] - numbers[slot - 1] != 1}
    alone, void = _time_breaks(arm, numbers, counters, slots, log)
    breaks |= alone | set(void)
    breaks |= {int(slot) for slot in np.searchsorted(opens, bus_off) - 1}
    cycles = _assemble(arm, [numbers[slot] for slot in used], contents)
    for position, slot in enumerate(used):
        since = range(used[position - 1] + 1 if position else 0, slot + 1)
        if position == 0 or not breaks.isdisjoint(since):
            cycles.flags[position] |= BREAK_BEFORE
        trusted = [void[s] for s in since if s in void]
        if trusted:
            doubtful = min(numbers[slot] - min(trusted), 2 ** (32 - VOID_SHIFT) - 1)
            cycles.flags[position] |= VOID_BEFORE | doubtful << VOID_SHIFT
    log.faults = +log.faults
    return Reception(cycles, log.faults, tuple(log.verdicts))


def _each_frame(arm: Arm, frames: Sequence[Frame], log: _Log) -> tuple[list[_Seen], list[int]]:
    """The arm's frames that are valid on their own, and the positions at which the controller went bus-off."""
    kinds = identifiers(arm)
    ids = {i: data_ids(kind.family, kind.node) for i, kind in kinds.items() if kind.family is not None}
    seen: list[_Seen] = []
    bus_off: list[int] = []
    for at, frame in enumerate(frames):
        if frame.flags & ERROR:
            log.accept(at)
            log.faults["bus_error"] += 1
            if frame.id & BUS_OFF:
                bus_off.append(at)
            continue
        kind = kinds.get(frame.id)
        if kind is None or frame.flags:
            continue
        bad_length = len(frame.data) != kind.message.length
        bad_crc = not bad_length and frame.id in ids and not e2e_p02_check(frame.data, ids[frame.id], length=0)
        if bad_length or bad_crc:
            if kind.part != UNWANTED:
                log.reject(at, "length" if bad_length else "crc")
            continue
        raw = kind.message.decode(frame.data, decode_choices=False, scaling=False)
        assert isinstance(raw, dict)
        codes = {name: int(code) for name, code in raw.items() if isinstance(code, int)}
        sync = codes["Counter"] if kind.family is None else codes.get("Sync", 1)
        if not 1 <= sync <= SYNC_MODULUS:
            log.reject(at, "range")
            continue
        value = {s.name: codes[s.name] * float(s.scale) for s in kind.message.signals}
        seen.append(_Seen(at, kind, codes, value))
    return seen, bus_off


def _cycles_of(syncs: Sequence[_Seen], log: _Log) -> tuple[list[int], list[int], set[int]]:
    """Cycle number and position of each SYNC that opens a cycle, and the cycles in which a SYNC was repeated."""
    counters = np.array([s.raw["Counter"] for s in syncs], dtype=np.int64)
    steps = np.diff(counters, prepend=counters[:1]) % SYNC_MODULUS
    numbers = np.cumsum(steps)
    opening = steps != 0
    opening[:1] = True
    slot = np.cumsum(opening) - 1
    for s, opens_cycle in zip(syncs, opening, strict=True):
        if opens_cycle:
            log.accept(s.at)
        else:
            log.reject(s.at, "sync_repeated")
    log.faults["sync_jumped"] += int(np.sum(steps > 1))
    opens = [s.at for s, o in zip(syncs, opening, strict=True) if o]
    return [int(x) for x in numbers[opening]], opens, {int(x) for x in slot[~opening]}


def _judge(arm: Arm, frames: Sequence[_Seen], counter: int, log: _Log) -> tuple[dict[str, _Seen], bool]:
    """Valid frames of one cycle by part, and whether the cycle may be used."""
    content: dict[str, _Seen] = {}
    sound = True
    for s in frames:
        if s.kind.part is None:
            continue
        if s.kind.part == UNWANTED:
            sound = False
            log.reject(s.at, "gyro_invalid")
            continue
        if s.raw["Counter"] != counter % 16:
            log.reject(s.at, "late" if s.raw["Counter"] == (counter - 1) % 16 else "counter")
            continue
        fault = "repeated" if s.kind.part in content else _fault(arm, s)
        if fault is None:
            content[s.kind.part] = s
            log.accept(s.at)
        else:
            sound = False
            log.reject(s.at, fault)
    return content, sound


def _fault(arm: Arm, s: _Seen) -> str | None:
    """The reason why a frame of the right cycle has no value, or None."""
    raw, status = s.raw, s.raw["Status"]
    invalid = -(2**23)
    if not s.kind.of_joint:
        rates = [name for name in raw if name.startswith("Rate")]
        saturated = any(_outermost(s.kind.message, name, raw[name]) for name in rates)
        checks = [("gyro_invalid", not status & 1), ("saturated", saturated)]
    else:
        rigid = not arm.joints[s.kind.joint].flexible  # its link encoder is not used
        checks = [(fault, not status & bit) for fault, bit in STATUS_FAULTS if not (rigid and fault == "link_invalid")]
    if s.kind.content == "angles":
        checks.append(("link_invalid", raw["LinkAngle"] == invalid and not rigid))
        checks.append(("motor_invalid", raw["MotorAngle"] == invalid))
    elif s.kind.content == "torque":
        late = raw["Latch"] - arm.joints[s.kind.joint].latch_us
        checks.append(("saturated", _outermost(s.kind.message, "Torque", raw["Torque"])))
        checks.append(("latch", abs(late) > LATCH_TOLERANCE_US))
    return next((fault for fault, true in checks if true), None)


def _outermost(message: Message, name: str, code: int) -> bool:
    limit = 1 << (message.get_signal_by_name(name).length - 1)
    return code in (-limit, limit - 1)


def _time_breaks(
    arm: Arm, numbers: Sequence[int], counters: Sequence[int], slots: Sequence[Sequence[_Seen]], log: _Log
) -> tuple[set[int], dict[int, int]]:
    """Cycles before which the count is interrupted, because FTIME was silent or disagrees with the count. The second
    result has those whose FTIME shows that cycles are missing, with the number of the cycle of the previous FTIME.

    The comparison is with the previous FTIME, however long ago it came.
    """
    alone: set[int] = set()
    void: dict[int, int] = {}
    last: tuple[int, int] | None = None
    silent_since = 0
    lost = False
    for slot, number in enumerate(numbers):
        if number - silent_since > MAX_CYCLES_WITHOUT_TIME:
            log.faults["time_lost"] += not lost
            lost = True
            alone.add(slot)
        for s in slots[slot]:
            if s.kind.part is not None:
                continue
            if s.raw["Sync"] != counters[slot] or s.raw["Counter"] != counters[slot] % 16:
                behind = s.raw["Sync"] == (counters[slot] - 2) % SYNC_MODULUS + 1
                log.reject(s.at, "late" if behind and s.raw["Counter"] == s.raw["Sync"] % 16 else "counter")
                continue
            log.accept(s.at)
            if last is not None:
                elapsed = ((s.raw["Time"] - last[1] + 2**31) % 2**32 - 2**31) * 1e-6  # a clock may wrap around
                missing = elapsed - (number - last[0]) * arm.period_s
                if abs(missing) > 0.5 * arm.period_s:
                    log.faults["time_jumped"] += 1
                    alone.add(slot)
                if missing > 0.5 * arm.period_s:
                    void.setdefault(slot, last[0])
            last, silent_since, lost = (number, s.raw["Time"]), number, False
    return alone, void


def _assemble(arm: Arm, numbers: Sequence[int], contents: Sequence[dict[str, _Seen]]) -> Cycles:
    joints = range(len(arm.joints))

    def table(parts: Sequence[tuple[str, str]]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        values = [[content[part].value[name] for part, name in parts] for content in contents]
        return np.array(values, dtype=np.float64).reshape(len(contents), len(parts))

    coarse = arm.imu.resolution == "coarse"
    rates = [("rate" if coarse else "rate_z" if axis == "Z" else "rate_xy", f"Rate{axis}") for axis in "XYZ"]
    return Cycles(
        sync=np.array(numbers, dtype=np.uint64),
        q=table([(f"angles{i}", "LinkAngle" if arm.joints[i].flexible else "MotorAngle") for i in joints]),
        theta=table([(f"angles{i}", "MotorAngle") for i in joints]),
        tau=table([(f"torque{i}", "Torque") for i in joints]),
        omega=table(rates) if arm.imu.node else np.zeros((len(contents), 3)),
        flags=np.zeros(len(contents), dtype=np.uint32),
    )
