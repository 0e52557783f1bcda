# SPDX-License-Identifier: MIT
"""What `zygos listen` shows while frames arrive: on a terminal a table in place, elsewhere a line from time to time."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np
from rich.live import Live
from rich.table import Table

from zygos.estimation.watch import Watch
from zygos.estimation.words import losses
from zygos.files.output import counted, errors, note, number
from zygos.native.flight import REASONS, Estimate, lib

TABLE_S, LINE_S = 1.0, 2.0
"""Time between two states of the table, and between two lines, s."""
_TOO_EARLY = {
    REASONS[code] for code in (lib.ZYGOS_REASON_NO_DATA, lib.ZYGOS_REASON_NOT_IDENTIFIABLE, lib.ZYGOS_REASON_NOISE)
}
"""Reasons of a refusal that more motion removes: too few instants, a motion that does not determine every parameter,
noise as large as the motion."""


def state_of(result: Estimate) -> str:
    """The validity in a word; `learning` where there is only too little data so far."""
    return "learning" if result.validity == "refused" and result.reason in _TOO_EARLY else result.validity


def line_of(watch: Watch, result: Estimate) -> str:
    """The state of an estimate in a line."""
    cycles = counted(watch.flight.counts["cycles"], "cycle")
    known = f"{np.isfinite(result.value).sum()}/{len(result.names)} parameters"
    changed = " · the arm changed" if watch.plainest and watch.plainest.changed else ""
    return f"{cycles:>16} · {losses(watch.flight)} · {known} · {state_of(result)}{changed}"


def table_of(watch: Watch, result: Estimate) -> Table:
    """Values with their intervals, and below them the state, the residual and the health of the bus."""
    residual = f"residual {number(result.residual, 3)} J" if np.isfinite(result.residual) else "no residual yet"
    table = Table(caption=f"{line_of(watch, result).strip()} · {residual}", caption_justify="left")
    for heading in ("name", "value", "± 95 %", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "± 95 %") else "left")
    for name, value, half95, unit in zip(result.names, result.value, result.half95, result.units, strict=True):
        table.add_row(name, number(value, 7), number(half95, 2), unit)
    return table


class Shown(Protocol):
    """What has been heard so far, as a line and as a table."""

    def line(self) -> str:
        """The state in a line."""

    def table(self) -> Table:
        """The state in a table."""


class Screen:
    """Shows a state as often as it may change; a context."""

    def __init__(self, shown: Shown) -> None:
        """Show nothing yet."""
        self._of, self._shown = shown, time.monotonic()
        self._table = Live(console=errors, auto_refresh=False) if errors.is_terminal else None

    def __enter__(self) -> Screen:
        """Begin with the table, if there is one."""
        if self._table:
            self._table.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last table where it is."""
        if self._table:
            self._table.stop()

    def due(self) -> bool:
        """Whether it is time for a new state: what has arrived should be worked off before."""
        return time.monotonic() - self._shown > (TABLE_S if self._table else LINE_S)

    def show(self) -> None:
        """Show the state so far."""
        if self._table:
            self._table.update(self._of.table(), refresh=True)
        else:
            note(self._of.line())
        self._shown = time.monotonic()
