# SPDX-License-Identifier: MIT
"""The DBC of one arm: the shipped file with this arm's nodes, names, times and parameters."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.namedsignalvalue import NamedSignalValue

from zygos.arm import Arm, Joint
from zygos.can.wire import data_ids, database
from zygos.effects import Effect, with_gains
from zygos.errors import ZygosError
from zygos.files.names import ascii_name, printable

COMPUTER, IMU = "COMPUTER", "IMU"
"""Nodes of the shipped DBC that every free-floating arm has."""


_RESERVED = {word.casefold() for word in (COMPUTER, IMU, "VERSION", "FILTER", "INT", "HEX", "FLOAT", "STRING", "ENUM")}
"""Names that a joint may not have: nodes of the file and keywords of the format. The format's other keywords begin or
end with an underscore."""


_LONGEST = 20
"""Longest name of a joint; with the longest signal suffix, _Temperature, it has the 32 characters that all tools
read."""


_HEADER = ("Crc", "Counter", "Status")
"""Signals that have the same name in each frame."""


_MOST_PARAMETERS = 256
"""Largest number of parameters: their index in the telemetry is a byte."""


_OF_PARAMETERS = {"": 0, "_sigma": 1, "_half95": 4, "_refined": 5, "_refined_sigma": 6}
"""What the telemetry reports of a parameter: suffix of the signal's name, and its kind, the upper byte of Item."""


_OF_REFINEMENT = (5, 6, 7)
"""Kinds of which only an arm with flexible joints alone has signals; an effect has none of the first two."""


def joint_names(arm: Arm) -> tuple[str, ...]:
    """The joints' names in the DBC, which differ even when case is ignored, with at most 20 characters.

    A name without a letter or digit of ASCII becomes JOINT and the node number; one that begins with a digit gets a J
    in front. If two names would be equal, or one is reserved, every name ends in its node number.
    """
    names = []
    for joint in arm.joints:
        name = ascii_name(joint.name) or f"JOINT{joint.node}"
        names.append((f"J{name}" if name[0].isdigit() else name)[:_LONGEST].rstrip("_"))
    folded = [name.casefold() for name in names]
    if len(set(folded)) == len(folded) and _RESERVED.isdisjoint(folded):
        return tuple(names)
    # the parts after the last underscore are the node numbers, which differ
    return tuple(
        f"{name[: _LONGEST - 3].rstrip('_')}_{joint.node}" for name, joint in zip(names, arm.joints, strict=True)
    )


def arm_database(arm: Arm, effects: Sequence[Effect] = ()) -> Database:
    """The DBC of an arm, derived from zygos.dbc and zygos-coarse-gyro.dbc, from which layouts, scales and ranges are
    taken.

    effects: those whose values are estimated. Errors: ZygosError if the telemetry has no index for that many
    parameters.
    """
    learned = with_gains(arm, effects)
    count = len(arm.parameter_names) + len(learned)
    if count > _MOST_PARAMETERS:
        raise ZygosError(
            f"arm {arm.name}: {count} parameters, but the telemetry can report at most "
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
    messages.append(_telemetry(shipped, arm, learned))
    for message in messages:
        message.cycle_time = max(1, round(1e3 * arm.period_s * cycles_between(message)))
        _explain_crc(message)
        message.refresh()
    messages.append(deepcopy(shipped.get_message_by_name("HEARTBEAT")))
    return Database(messages, nodes, version=shipped.version, dbc_specifics=deepcopy(shipped.dbc))


def cycles_between(message: Message) -> float:
    """Number of SYNC cycles between two frames of a message of the shipped DBC."""
    period = database().get_message_by_name("SYNC").cycle_time
    assert message.cycle_time is not None and period is not None
    return message.cycle_time / period


def _attributes(message: Message) -> Mapping[str, Any]:
    assert message.dbc is not None
    return message.dbc.attributes


def _title(i: int, joint: Joint) -> str:
    """Name of joint i (from 0) in comments."""
    return f"joint {i + 1}, {printable(joint.name)}"


def _at_node(message: Message, node: int) -> Message:
    """A message of the shipped DBC as sent by another node."""
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
            rigid = "" if joint.flexible else " The joint is rigid: its motor encoder measures both angles."
            angle = f"The joint's angle is {encoder.sign:+d} * (reading - {encoder.zero_rad:.9g} rad)."
            signal.comment = f"{signal.comment}{rigid} {angle}"
        elif signal.name == "Latch":
            signal.comment = f"{signal.comment} The arm file says {joint.latch_us} us."
        signal.name = f"{name}_{signal.name}"
    return message


def _telemetry(shipped: Database, arm: Arm, effects: Sequence[Effect]) -> Message:
    """Frame 0x1A0, with signals for each parameter of the arm in place of the shipped ones."""
    message = deepcopy(shipped.get_message_by_name("TELEMETRY"))
    item = message.get_signal_by_name("Item")
    likes = {signal.name: signal for signal in message.signals}
    unrefined = () if all(joint.flexible for joint in arm.joints) else _OF_REFINEMENT
    replaced = {*_OF_PARAMETERS.values(), *unrefined}
    signals = [signal for signal in message.signals if _kind(signal) not in replaced]
    choices = OrderedDict(item.conversion.choices or {})
    for place in [place for place in choices if place >> 8 in replaced]:
        del choices[place]
    columns = {effect.column(arm) for effect in effects}
    for index, (name, unit, comment) in enumerate(_parameters(arm, effects, likes)):
        left_out = _OF_REFINEMENT if name in columns else unrefined
        for end, kind in _OF_PARAMETERS.items():
            if kind in left_out:
                continue
            signal = copy(likes[f"a00{end}"])  # no part of it is changed, only which it has
            signal.name, signal.unit = f"{ascii_name(name)}{end}", unit
            signal.comment = str(signal.comment).replace("a00", name) if end else comment
            if end == "_sigma" and name in columns:
                signal.comment += f" |{name}| divided by it is the significance of the effect."
            place = 256 * kind + index
            signal.multiplexer_ids = [place]
            signals.append(signal)
            choices[place] = NamedSignalValue(place, f"{name}{end.replace('_', ' ')}")
    message.signals[:] = signals
    message.comment = re.sub(r" The parameters are .* of an arm\.", "", str(message.comment))
    item.conversion.choices = OrderedDict(sorted(choices.items()))
    return message


def _kind(signal: Signal) -> int | None:
    """The kind of telemetry that a signal carries; None for signals of the header."""
    return next(iter(signal.multiplexer_ids)) >> 8 if signal.multiplexer_ids else None


def _parameters(arm: Arm, effects: Sequence[Effect], likes: Mapping[str, Signal]) -> Iterator[tuple[str, str, str]]:
    """Name, unit and comment of each parameter that is estimated."""
    for one in arm.parameters:
        if one.joint is not None:
            like = likes[replace(one, joint=0).name]
            yield one.name, one.unit, f"{like.comment} Of {_title(one.joint, arm.joints[one.joint])}."
        elif one.symbol == "G":
            yield one.name, one.unit, "Base parameter of the potential energy."
        elif one.symbol in ("N", "a", "b"):
            yield one.name, one.unit, str(likes["a00"].comment)
        else:
            yield one.name, one.unit, f"Base parameter of body {one.ends[0]} and of what moves with it."
    for effect in effects:
        title, joint = effect.kind.title, effect.index(arm)
        yield effect.column(arm), effect.kind.unit, f"{title.capitalize()}, {_title(joint, arm.joints[joint])}."


def _explain_crc(message: Message) -> None:
    attributes = _attributes(message)
    if "E2EFamily" not in attributes:
        return
    identifiers = data_ids(attributes["E2EFamily"].value, attributes["E2ENode"].value)
    message.get_signal_by_name("Crc").comment = (
        "E2E profile 2: CRC-8, polynomial 0x2F, initial value and final XOR 0xFF, over the bytes behind this one and "
        f"then the data identifier, for Counter 0 to 15: {' '.join(map(str, identifiers))}."
    )
