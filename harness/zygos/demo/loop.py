# SPDX-License-Identifier: MIT
"""The loop that `make loop` closes: a node flies with the simulation's model, its traffic explains the gap, and the
node flies on with the model that was adopted.

The plant's frames are the logs of examples/gap/demo, which a MuJoCo plant with a hidden effect wrote. `zygos-node`
hears them through a pair of sockets. All that passes there, the node's answers included, is recorded as candump does,
and `zygos explain` gets no other runs. The sealed solution is read only after the last run has been flown and judged.
tests/hil/test_loop.py closes the same loop over a real vcan with candump.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from zygos.arm import load_arm
from zygos.can import bus
from zygos.can.dbc import arm_database
from zygos.can.rounds import rounds
from zygos.demo.demonstration import GAP, run_zygos
from zygos.effects import estimated
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, note, number, say, table, write_json
from zygos.model.model import load_model

NODE = Path("build/zygos-node")
EVERY = 25
"""SYNCs between two estimates of the node. At most 8 SYNCs in a row are without an answer, also while no parameter has
a value; a sender that waits for answers needs one in 15."""
_SYNC = 0x080
_CAN_FRAME = struct.Struct("=IB3x8s")

Fly = Callable[[Path, NDArray[Any], Path], None]
"""Flies a run: starts a node with a compiled configuration (arm.zyg), sends it frames, records all traffic in a log."""


@dataclass(frozen=True)
class Closed:
    """What a closed loop leaves behind."""

    content: dict[str, Any]
    """Its JSON."""
    before: list[dict[str, float]]
    """What the node told of run D with the simulation's model, a round for each estimate."""
    after: list[dict[str, float]]
    """The same with the adopted model."""


def fly_beside(config: Path, frames: NDArray[Any], log: Path) -> None:
    """Fly a run with a node at the other end of a pair of sockets, which needs no interface of the kernel's.

    Errors: ZygosError if there is no node, or if it does not end in order.
    """
    if not NODE.exists():
        raise ZygosError(f"there is no {NODE}; remedy: make node")
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [str(NODE), "--config", str(config), "--fd", str(far.fileno()), "--every", str(EVERY)]
    with subprocess.Popen(
        command, pass_fds=[far.fileno()], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as node:
        far.close()
        with near:
            traffic = _traffic(near, bus.to_messages(frames, load_arm(GAP / "arm.toml").period_s))
        said = node.communicate()[1]
    if node.returncode:
        raise ZygosError(f"{NODE} ended with status {node.returncode}: {said.strip()}; remedy: make node")
    recording = bus.LogWriter(log)
    recording.append(traffic)
    recording.finish()


def _traffic(near: socket.socket, messages: Sequence[can.Message]) -> list[can.Message]:
    """Send messages to a node, and tell it that no more come. Returns them and its answers, as they passed."""
    passed: list[can.Message] = []
    try:
        for message in messages:
            near.send(_CAN_FRAME.pack(message.arbitration_id, message.dlc, bytes(message.data).ljust(8, b"\0")))
            passed.append(message)
            if message.arbitration_id == _SYNC:
                passed += _heard(near, message.timestamp, wait=False)
        near.shutdown(socket.SHUT_WR)
        passed += _heard(near, messages[-1].timestamp, wait=True)
    except (BrokenPipeError, ConnectionResetError):
        pass  # the node has ended, and its status says why
    return passed


def _heard(near: socket.socket, stamp: float, *, wait: bool) -> Iterator[can.Message]:
    """What the node has sent; where `wait` is set, until it ends."""
    while True:
        try:
            data = near.recv(100, 0 if wait else socket.MSG_DONTWAIT)
        except (BlockingIOError, ConnectionResetError):
            return
        if not data:
            return
        identifier, length, payload = _CAN_FRAME.unpack(data)
        yield can.Message(timestamp=stamp, arbitration_id=identifier, is_extended_id=False, data=payload[:length])


def first(frames: NDArray[Any], cycles: int | None) -> NDArray[Any]:
    """The first cycles of a run, with the SYNC that closes the last one; None: all of them."""
    starts = np.flatnonzero(frames["id"] == _SYNC)
    return frames if cycles is None or cycles >= len(starts) else frames[: starts[cycles] + 1]


def compiled(model: Path, folder: Path) -> Path:
    """The configuration with the effects of a model, compiled into the folder by `zygos compile-model`."""
    run_zygos("compile-model", GAP / "arm.toml", "--model", model, "-o", folder)
    return folder / "arm.zyg"


def explained(folder: Path, validate: Path, out: Path) -> dict[str, Any]:
    """The verdict of `zygos explain` on the recorded runs A and B, with another one untouched. Writes out, a model."""
    verdict = out.with_suffix(".json")
    run_zygos(
        "explain",
        *(folder / "a.log", folder / "b.log"),
        *("--simulation", GAP / "cad.toml"),
        *("--validate", validate),
        *("--arm", GAP / "arm.toml"),
        *("-o", out, "--json", verdict),
    )
    content: dict[str, Any] = json.loads(verdict.read_text())
    return content


def told(model: Path, log: Path) -> list[dict[str, float]]:
    """What the node told in a recorded run, decoded by the DBC of the arm with a model's effects: at least one round.

    Errors: ZygosError where it told no complete estimate.
    """
    database = arm_database(load_arm(GAP / "arm.toml"), load_model(model).effects)
    heard = rounds(database, bus.read_messages(log, []))
    if not heard:
        raise ZygosError(f"{log}: the node has told no complete estimate; remedy: a longer run, or more patience")
    return heard


def close_loop(folder: Path, fly: Fly, *, cycles: int | None = None) -> Closed:
    """Close the loop with a way to fly runs; all files go into the folder.

    cycles: how many of each run are flown; None: all, which are 60 s of A, B and C, and 30 s of D.

    Errors: ZygosError where nothing could be named, or where a step fails.
    """
    folder.mkdir(parents=True, exist_ok=True)
    arm, drawn, adopted = load_arm(GAP / "arm.toml"), GAP / "cad.toml", folder / "new.toml"
    runs = {name: first(bus.read_log(GAP / "demo" / f"{name}.blf").frames, cycles) for name in "abcd"}

    note("flying runs A, B and C with the simulation's model …")
    before = compiled(drawn, folder / "before")
    for name in "abc":
        fly(before, runs[name], folder / f"{name}.log")

    note("explaining what was recorded …")
    verdict = explained(folder, folder / "c.log", adopted)
    if verdict["answer"] != "named":
        raise ZygosError(f"{verdict['answer']}: {verdict['sentence']}; remedy: read {adopted.with_suffix('.json')}")

    note("adopting the model, and flying run D with it …")
    after = compiled(adopted, folder / "after")
    fly(after, runs["d"], folder / "d.log")
    fly(before, runs["d"], folder / "d-before.log")

    # The models are those from before run D: explain learns from A and B alone, and must write the same again.
    again = explained(folder, folder / "d.log", folder / "again.toml")
    if load_model(folder / "again.toml") != load_model(adopted):
        raise ZygosError("the model explained from runs A and B is another one when D is untouched; remedy: report it")
    told_before, told_after = told(drawn, folder / "d-before.log"), told(adopted, folder / "d.log")

    # Scoring starts here: everything has been flown and judged, and nothing below changes it.
    sealed = json.loads((GAP / "demo" / "sealed.json").read_text())
    columns = [one.column(arm) for one in estimated(arm, load_model(adopted).effects) if not one.kind.gain]
    content = {
        "named": [{"effect": one["effect"], "joint": one["joint"]} for one in verdict["findings"]],
        "hidden": [{"effect": sealed["hidden"], "joint": sealed["where"]}],
        "promised": _gap(verdict["gap"]),
        "flown": _gap(again["gap"]),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "true": true,
                "before": _told(told_before[-1], name),
                "after": _told(told_after[-1], name),
            }
            for name, unit, true in zip(
                arm.parameter_names, arm.parameter_units, sealed["true_values"].values(), strict=True
            )
        ],
        "effects": [
            {
                "column": column,
                "unit": finding["unit"],
                "true": sealed["size"],
                "explained": finding["value"],
                **_told(told_after[-1], column),
                "significance": abs(told_after[-1][column]) / told_after[-1][f"{column}_sigma"],
            }
            for column, finding in zip(columns, verdict["findings"], strict=True)
        ],
    }
    return Closed(content, told_before, told_after)


def _gap(gap: Mapping[str, float]) -> dict[str, float]:
    return {name: gap[name] for name in ("as_delivered", "refit", "closed", "floor", "shrinks")}


def _told(last: Mapping[str, float], name: str) -> dict[str, float | None]:
    """Value, sigma and half width of an interval as the node sent them; None where it had no value."""
    return {"value": last.get(name), "sigma": last.get(f"{name}_sigma"), "half95": last.get(f"{name}_half95")}


def errors(content: Mapping[str, Any], when: str) -> NDArray[np.float64]:
    """Errors of the parameters that the node told "before" or "after", as shares of the true values; NaN where there
    was no value."""
    return np.array(
        [
            np.nan if one[when]["value"] is None else one[when]["value"] / one["true"] - 1.0
            for one in content["parameters"]
        ]
    )


def run_loop(folder: Path = Path("out/loop")) -> None:
    """Close the loop beside a node of this machine, print the table, and write folder.json and folder/loop.svg."""
    from zygos.demo.picture import draw_loop  # noqa: PLC0415  (only the picture needs matplotlib)

    check_outputs([folder.with_suffix(".json"), folder / "loop.svg"], [])
    closed = close_loop(folder, fly_beside)
    content = closed.content
    write_json(folder.with_suffix(".json"), content)
    draw_loop(folder / "loop.svg", closed, load_arm(GAP / "arm.toml").period_s)
    show(content)
    say(f"picture: {folder / 'loop.svg'} · numbers: {folder.with_suffix('.json')}")


def show(content: Mapping[str, Any]) -> None:
    """Print what a closed loop brought."""
    before, after = errors(content, "before"), errors(content, "after")
    table(
        ("name", "unit", "true", "told before", "error", "told after", "error"),
        [
            (
                one["name"],
                one["unit"],
                number(one["true"], 7),
                number(one["before"]["value"], 7),
                f"{100 * b:+.2g} %",
                number(one["after"]["value"], 7),
                f"{100 * a:+.2g} %",
            )
            for one, b, a in zip(content["parameters"], before, after, strict=True)
        ],
    )
    for one in content["effects"]:
        say(
            f"{one['column']}: told on board {number(one['value'], 4)} ± {number(one['half95'], 2)} {one['unit']}, "
            f"significance {number(one['significance'], 3)} (explained {number(one['explained'], 4)}, hidden "
            f"{number(one['true'], 4)})"
        )
    for title, name in (("promised by the untouched run", "promised"), ("the next run", "flown")):
        gap = content[name]
        say(
            f"{title}: gap {number(gap['refit'], 3)} refit, {number(gap['closed'], 3)} closed, "
            f"{number(gap['shrinks'], 3)} times smaller"
        )


if __name__ == "__main__":
    from zygos.files.output import errors_end_the_program

    with errors_end_the_program():
        run_loop(*map(Path, sys.argv[1:]))
