"""The DBC of one arm: the shipped one, with this arm's nodes, names, times and parameters."""

from __future__ import annotations

import re
import unicodedata
from collections import OrderedDict
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.namedsignalvalue import NamedSignalValue
from cantools.database.utils import sort_signals_by_start_bit

from zygos.arm import Arm, Joint, load_arm
from zygos.errors import ZygosError
from zygos.output import check_outputs, counted, say, table, write_json, write_text
from zygos.reference.wire import data_ids, database

COMPUTER, IMU = "COMPUTER", "IMU"
"""Nodes of the shipped DBC that every free-floating arm has."""
_RESERVED = {word.casefold() for word in (COMPUTER, IMU, "VERSION", "FILTER", "INT", "HEX", "FLOAT", "STRING", "ENUM")}
"""Nodes of the file, and words of the format that a joint's name could be; the others have an underscore at an end."""
_LONGEST = 20
"""Of a joint's name: with the longest signal, _Temperature, it makes the 32 characters that every CAN tool reads."""
_HEADER = ("Crc", "Counter", "Status")
"""Signals that bear the same name in each frame."""
_MOST_PARAMETERS = 256
"""The telemetry's index is a byte."""


def _without_marks(text: str) -> str:
    """Text in ASCII, as far as leaving out accents and dots makes it so."""
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()


def ascii_name(text: str) -> str:
    """A name as identifier of a DBC: letters without their marks, digits, and _ for whatever else; may be empty."""
    return re.sub("[^A-Za-z0-9]+", "_", _without_marks(text)).strip("_")


def joint_names(arm: Arm) -> tuple[str, ...]:
    """The joints' names in the DBC, unlike each other in any case of letters, at most 20 characters.

    A name without a letter or digit of ASCII becomes JOINT and the node number; one that begins with a digit is
    preceded by J. Where two names would be alike, or one is reserved, all of them end in their node numbers.
    """
    names = []
    for joint in arm.joints:
        name = ascii_name(joint.name) or f"JOINT{joint.node}"
        names.append((f"J{name}" if name[0].isdigit() else name)[:_LONGEST].rstrip("_"))
    folded = [name.casefold() for name in names]
    if len(set(folded)) == len(folded) and _RESERVED.isdisjoint(folded):
        return tuple(names)
    # node numbers differ, and so do the names behind whose last underscore they stand
    return tuple(
        f"{name[: _LONGEST - 3].rstrip('_')}_{joint.node}" for name, joint in zip(names, arm.joints, strict=True)
    )


def arm_database(arm: Arm) -> Database:
    """The DBC of an arm, derived from zygos.dbc and zygos-coarse-gyro.dbc: layouts, scales and ranges are theirs.

    Errors: ZygosError if the arm has more parameters than the telemetry can name.
    """
    if len(arm.parameter_names) > _MOST_PARAMETERS:
        raise ZygosError(
            f"arm {arm.name}: {len(arm.parameter_names)} parameters, but the telemetry's index names "
            f"{_MOST_PARAMETERS}; remedy: describe fewer joints"
        )
    shipped = database()
    names = joint_names(arm)
    listeners = [*names, *([IMU] if arm.free else [])]
    computer = shipped.get_node_by_name(COMPUTER).comment
    nodes = [Node(COMPUTER, comment=f"{computer} It serves the arm {printable(arm.name)}.")]
    messages = [deepcopy(shipped.get_message_by_name(name)) for name in ("SYNC", "FTIME")]
    for message in messages:
        for signal in message.signals:
            signal.receivers = listeners
    messages[0].comment = f"{messages[0].comment} Every {1e3 * arm.period_s:g} ms."
    for i, (joint, name) in enumerate(zip(arm.joints, names, strict=True)):
        title = _title(i, joint)
        nodes.append(Node(name, comment=f"Drive of {title}, node {joint.node}."))
        messages += [_of_joint(shipped, kind, joint, name, title) for kind in ("ANGLES", "TORQUE")]
    if arm.free:
        nodes.append(Node(IMU, comment=f"Gyro and attitude of the base, node {arm.imu.node}."))
        coarse = arm.imu.resolution == "coarse"
        gyro = (
            database(coarse_gyro=True).messages
            if coarse
            else [shipped.get_message_by_name(f"IMU_RATE_{axes}") for axes in ("XY", "Z")]
        )
        messages += [
            _at_node(message, arm.imu.node) for message in (*gyro, shipped.get_message_by_name("IMU_ATTITUDE"))
        ]
    messages.append(_telemetry(shipped, arm))
    for message in messages:
        message.cycle_time = max(1, round(1e3 * arm.period_s * cycles_between(message)))
        _explain_crc(message)
        message.refresh()
    return Database(messages, nodes, version=shipped.version, dbc_specifics=deepcopy(shipped.dbc))


def cycles_between(message: Message) -> float:
    """SYNC cycles from one frame of a message of the shipped DBC to the next."""
    period = database().get_message_by_name("SYNC").cycle_time
    assert message.cycle_time is not None and period is not None
    return message.cycle_time / period


def _attributes(message: Message) -> Mapping[str, Any]:
    assert message.dbc is not None
    return message.dbc.attributes


def _title(i: int, joint: Joint) -> str:
    """What comments call joint i, from 0."""
    return f"joint {i + 1}, {printable(joint.name)}"


def printable(name: str) -> str:
    """A name in a comment: ASCII without quotes, for the format states no encoding."""
    plain = re.sub(r'[^ -~]|["\\]', " ", _without_marks(name))
    return " ".join(plain.split()) or "unnamed"


def _at_node(message: Message, node: int) -> Message:
    """A message of the shipped DBC as another node sends it."""
    clone = deepcopy(message)
    attribute = _attributes(clone)["E2ENode"]
    clone.frame_id += node - attribute.value
    attribute.value = node
    return clone


def _of_joint(shipped: Database, kind: str, joint: Joint, name: str, title: str) -> Message:
    message = _at_node(shipped.get_message_by_name(f"JOINT1_{kind}"), joint.node)
    message.name = f"{name}_{kind}"
    message.senders[:] = [name]
    message.comment = f"{'Angles' if kind == 'ANGLES' else 'Torque'} of {title}, node {joint.node}."
    for signal in message.signals:
        if signal.name in _HEADER:
            continue
        if signal.name in ("LinkAngle", "MotorAngle"):
            encoder = joint.link_encoder if signal.name == "LinkAngle" else joint.motor_encoder
            rigid = "" if joint.flexible else " The joint is rigid: its motor encoder speaks for both sides."
            angle = f"The joint's angle is {encoder.sign:+d} * (reading - {encoder.zero_rad:.9g} rad)."
            signal.comment = f"{signal.comment}{rigid} {angle}"
        elif signal.name == "Latch":
            signal.comment = f"{signal.comment} The arm file says {joint.latch_us} us."
        signal.name = f"{name}_{signal.name}"
    return message


def _telemetry(shipped: Database, arm: Arm) -> Message:
    """Frame 0x1A0, with a signal for each parameter of the arm in the place of the shipped ones."""
    message = deepcopy(shipped.get_message_by_name("TELEMETRY"))
    known = {signal.name: signal for signal in message.signals if signal.multiplexer_ids}
    titles = {f"{kind}{i + 1}": _title(i, arm.joints[i]) for kind, i, _ in arm.joint_parameters}
    parameters: list[Signal] = []
    for index, (name, unit) in enumerate(zip(arm.parameter_names, arm.parameter_units, strict=True)):
        if name in titles:
            like = known[f"{name.rstrip('0123456789')}1"]
            comment = f"{like.comment} Of {titles[name]}."
        else:
            like = known["a00"]
            comment = str(like.comment) if unit == like.unit else "Base parameter of the potential energy."
        signal = deepcopy(like)
        signal.name, signal.unit, signal.comment = ascii_name(name), unit, comment
        signal.multiplexer_ids = [index]
        parameters.append(signal)
    message.signals[:] = [signal for signal in message.signals if not signal.multiplexer_ids] + parameters
    message.comment = (
        "One value of the estimate, named by Index: the parameters in the order of the estimator's output."
    )
    choices: OrderedDict[int, str | NamedSignalValue] = OrderedDict()
    for index, name in enumerate(arm.parameter_names):
        choices[index] = NamedSignalValue(index, name)
    message.get_signal_by_name("Index").conversion.choices = choices
    return message


def _explain_crc(message: Message) -> None:
    attributes = _attributes(message)
    if "E2EFamily" not in attributes:
        return
    identifiers = data_ids(attributes["E2EFamily"].value, attributes["E2ENode"].value)
    message.get_signal_by_name("Crc").comment = (
        "E2E profile 2: CRC-8, polynomial 0x2F, initial value and final XOR 0xFF, over the bytes behind this one and "
        f"then the data identifier, for Counter 0 to 15: {' '.join(map(str, identifiers))}."
    )


def write_dbc(arm_file: Path, out: Path, json: str | None) -> None:
    """Write the DBC of an arm; see `zygos dbc --help`."""
    if out.suffix.lower() != ".dbc":
        raise ZygosError(f"{out}: no name for a DBC; remedy: let it end in .dbc")
    check_outputs([out, json], [arm_file])
    arm = load_arm(arm_file)
    content = arm_database(arm)
    write_text(out, content.as_dbc_string(sort_signals=sort_signals_by_start_bit))
    if json:
        listed = [
            {
                "name": message.name,
                "id": message.frame_id,
                "bytes": message.length,
                "sender": message.senders[0],
                "cycle_ms": message.cycle_time,
                "signals": [signal.name for signal in message.signals],
            }
            for message in content.messages
        ]
        joints = {joint.name: name for joint, name in zip(arm.joints, joint_names(arm), strict=True)}
        write_json(json, {"dbc": str(out), "arm": arm.name, "joints": joints, "messages": listed})
    if json != "-":
        table(
            ("message", "identifier", "bytes", "sender", "every", "signals"),
            [
                (
                    message.name,
                    f"0x{message.frame_id:03X}",
                    str(message.length),
                    message.senders[0],
                    f"{message.cycle_time} ms",
                    str(len(message.signals)),
                )
                for message in content.messages
            ],
        )
        say(f"{out}: arm {arm.name}, {counted(len(content.messages), 'message')}")
