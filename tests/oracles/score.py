# SPDX-License-Identifier: MIT
"""Verdicts against the truth: this alone reads both.

A verdict is the JSON of `zygos explain`. What counts was stated before any run: where the hidden law has the form of
the catalogue's column, only *named* is right; where it has another, *part named* with the entry itself or one of the
families that its cell declares is right as well; outside the catalogue *unknown* is right, and *part named* with a
declared family. The true size of a law of another form is its projection on the column along the exact motion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from oracles.cells import Case
from oracles.hidden import Law, Motion

Json = Mapping[str, Any]
SAME = {
    "motor_coulomb": "link_coulomb",
    "motor_viscous": "link_viscous",
    "motor_stribeck": "link_stribeck",
    "viscous_asymmetry": "link_viscous_asymmetry",
}
"""Entries that are one where a joint is rigid: motor and link turn as one."""


OF_EACH_RUN = ("motor_zero", "link_zero", "gyro_bias")
"""Entries that are an unknown of each run: a verdict states them as errors of sensors, and not as effects."""


@dataclass(frozen=True)
class True_:
    """One effect that was hidden, as the catalogue would say it."""

    key: str
    """Empty: outside the catalogue."""
    joint: str | None
    size: float
    exact: bool
    """Whether the law has the form of the column."""
    near: tuple[str, ...]
    rigid: bool
    ratio: float
    """Gear ratio: a motor's torque is before the gear."""
    work: float = 0.0
    """The size by least squares of power, where rest does not count; 0: `size`."""
    shape: float | None = None
    """Of the law, where the entry has one."""

    def scale(self, effect: str, joint: str | None) -> float | None:
        """Factor from this size to that of an entry which is this effect; None where it is another."""
        if joint != self.joint:
            return None
        if effect == self.key:
            return 1.0
        if self.rigid and SAME.get(self.key) == effect:
            return self.ratio
        if self.rigid and SAME.get(effect) == self.key:
            return 1.0 / self.ratio
        return None

    def nearly(self, effect: str, joint: str | None) -> bool:
        """Whether an entry is a family that was declared for this effect."""
        return (joint == self.joint or joint is None or self.joint is None) and effect in self.near


@dataclass(frozen=True)
class Truth:
    """What a case hides, and what the right answer is."""

    group: str
    expected: str
    effects: tuple[True_, ...] = ()
    changed: tuple[str, ...] = ()
    """Names of the parameters that differ."""
    beside: tuple[tuple[str, str, tuple[float, ...]], ...] = ()
    """Effects of the torque sensors, by entry, joint and possible sizes (none: any), that may be named as well, since
    they are there, and need not be."""

    def is_beside(self, effect: str, joint: str | None, value: float) -> bool:
        """Whether an entry of that size is one of the torque sensors' errors."""
        for key, place, sizes in self.beside:
            if (effect, joint) == (key, place) and (
                not sizes or any(abs(value - size) < 0.25 * abs(size) for size in sizes)
            ):
                return True
        return False


def projected(law: Law, motions: Sequence[Motion], which: int, power: bool = False) -> float:
    """Size of a law on its column along the motions, by least squares of the torque, or of its power; its own size
    where it has no column."""
    columns = [law.column(motion) for motion in motions]
    if any(column is None for column in columns):
        return law.size
    column = np.concatenate([c for c in columns if c is not None])
    torque = np.concatenate([motion.torques[:, which] for motion in motions])
    if power and law.place != "base":
        rates = {
            "motor": lambda m: m.thetad[:, law.joint],
            "link": lambda m: m.qd[:, law.joint],
            "spring": lambda m: (m.thetad - m.qd)[:, law.joint],
        }[law.place]
        rate = np.concatenate([rates(motion) for motion in motions])
        column, torque = column * rate, torque * rate
    return float(column @ torque / (column @ column))


def truth(one: Case, motions: Sequence[Motion]) -> Truth:
    """The truth of a case; motions: of the runs that are learned from."""
    arm, plant = one.arm, one.plant
    effects = []
    for k, law in enumerate(plant.laws):
        at_base = law.place in ("base", "field")
        joint = arm.joints[law.joint]
        near = (*law.near, *one.cell.near)
        key = "" if one.cell.group == "without" else law.key
        effects.append(
            True_(
                key,
                None if at_base else joint.name,
                projected(law, motions, k),
                law.exact,
                near,
                not joint.flexible and not at_base,
                float(arm.gear_ratios[law.joint]),
                projected(law, motions, k, power=True),
                law.shape,
            )
        )
    for error in plant.sensors:
        name = None if error.joint < 0 else arm.joints[error.joint].name
        effects.append(True_(error.key, name, error.size, error.exact, error.near, False, 1.0))
    group, lacks = one.cell.group, one.cell.lacks
    if group == "structure":
        key = {"flexibility": "joint_flexibility", "coupling": "rotor_coupling", "": "angular_momentum"}[lacks]
        for i, joint in enumerate(arm.joints if lacks else arm.joints[:1]):
            size = {"flexibility": plant.model.joints[i].stiffness.value, "coupling": 1.0, "": one.cell.momentum}[lacks]
            effects.append(True_(key, joint.name if lacks else None, size, True, (), False, 1.0))
    symbol = {"stiffness": "k", "rotor_inertia": "Im", "damping": "b"}
    changed = tuple(f"{symbol[field]}{joint + 1}" for field, joint, _ in one.cell.changed)
    expected = {"null": "nothing missing", "values": "values differ", "outside": "unknown", "without": "unknown"}
    expected["change"] = "changed"
    return Truth(group, expected.get(group, "named"), tuple(effects), changed, _beside(one))


def _beside(one: Case) -> tuple[tuple[str, str, tuple[float, ...]], ...]:
    """Gains and offsets of the torque sensors; a gain is one relative to that of any other joint."""
    dirt = one.plant.dirt
    if dirt is None:
        return ()
    names, gain = [joint.name for joint in one.arm.joints], 1.0 + dirt.gain
    out = []
    for i, name in enumerate(names):
        sizes = tuple(float(gain[k] / gain[i] - 1.0) for k in range(len(names)) if k != i)
        out += [("torque_gain", name, sizes), ("torque_offset", name, ())]
    return tuple(out)


def _column(name: str, joints: Sequence[str]) -> tuple[str, str | None]:
    """Entry and joint of a column's name, whatever its shape."""
    name = name.partition("@")[0]
    component = re.fullmatch(r"(base_|gravity_|detent_|gyro_)(.*[a-z])[xyz]", name)
    if component is not None:
        return name[:-1], None
    found = re.fullmatch(r"(.*?)(\d+)", name)
    if found is None or int(found[2]) > len(joints):
        return name, None
    return found[1], joints[int(found[2]) - 1]


def score(true: Truth, verdict: Json, joints: Sequence[str]) -> dict[str, Any]:
    """What is right and wrong in a verdict; joints: names, from the base."""
    answer = verdict["answer"]
    names = answer in {"named", "part named", "cannot tell"}
    findings = list(verdict.get("findings") or []) if names else []
    beside = [true.is_beside(f["effect"], f["joint"], f["value"]) for f in findings]
    findings = [f for f, there in zip(findings, beside, strict=True) if not there]
    if names and not findings:
        # only what the torque sensors really have was named
        answer = "nothing missing" if answer == "named" else "unknown"
    said = [(f["effect"], f["joint"]) for f in findings]
    sets = [
        [pair, *(_column(c, joints) for c in f["cannot_tell_from"])] for pair, f in zip(said, findings, strict=True)
    ]
    effects = true.effects

    def hit(pair: tuple[str, str | None]) -> bool:
        return any(e.scale(*pair) is not None for e in effects)

    def near(pair: tuple[str, str | None]) -> bool:
        return any(e.nearly(*pair) for e in effects)

    out: dict[str, Any] = {
        "right": False,
        "first": False,
        "in_set": None,
        "set_size": float(np.mean([len(one) for one in sets])) if sets else None,
        "extra": sum(not hit(pair) and not near(pair) for pair in said),
        "false": False,
        "misnamed": False,
        "sizes": [],
    }
    if true.group == "null":
        out["false"] = bool(said)
        out["right"] = answer in {"nothing missing", "values differ"}
        out["extra"] = len(said)
        return out
    if true.group == "values":
        differing = {v["name"] for v in verdict.get("values") or [] if v["differs"]}
        out["right"] = answer == "values differ" and differing == set(true.changed)
        out["false"] = bool(said)
        return out
    if true.group == "change":
        changed = bool(said) and all(effect == "body_change" for effect, _ in said)
        out["right"] = answer == "changed" or (answer in {"named", "part named"} and changed)
        out["false"] = bool(said) and not changed
        return out
    own = [e for e in true.effects if e.key in OF_EACH_RUN]
    if own and len(own) == len(true.effects):
        seen = {_column(one["name"], joints): one["value"] for one in verdict.get("zeros") or []}
        known = [abs(seen.get((e.key, e.joint), 0.0) - e.size) < 0.25 * abs(e.size) for e in own]
        out["right"] = out["first"] = all(known) and not said and answer in {"nothing missing", "values differ"}
        return out
    if true.expected == "unknown":
        fair = bool(said) and all(near(pair) for pair in said)
        out["right"] = answer in {"unknown", "plain estimate"} or (answer == "part named" and fair)
        # a set that cannot be told apart claims no law
        out["misnamed"] = answer == "named" or (answer == "part named" and not fair)
        return out
    exact = all(e.exact for e in effects)
    # while a joint moves, a constant torque and a difference between the directions are one
    either = [
        pair for one in sets if len(one) > 1 and one[0][0] in ("torque_offset", "coulomb_asymmetry") for pair in one
    ]
    found = [any(e.scale(*pair) is not None for pair in (*said, *either)) for e in effects]
    loosely = [ok or any(e.nearly(*pair) for pair in said) for e, ok in zip(effects, found, strict=True)]
    if answer == "named":
        out["first"] = bool(said) and hit(said[0])
        out["right"] = all(found) and out["extra"] == 0
    elif answer == "part named" and not exact:
        out["first"] = bool(said) and (hit(said[0]) or near(said[0]))
        out["right"] = all(loosely) and out["extra"] == 0
    elif answer == "cannot tell":
        # motor and link of a rigid joint are one effect, and a set of such names is a name
        out["first"] = all(hit(pair) for one in sets for pair in one)
        out["right"] = out["first"] and all(found)
    if said:
        out["in_set"] = all(
            any(e.scale(*pair) is not None or (not e.exact and e.nearly(*pair)) for one in sets for pair in one)
            for e in effects
        )
    out["misnamed"] = answer == "named" and not any(found)
    for e in effects:
        for finding, pair in zip(findings, said, strict=True):
            scale = e.scale(*pair)
            if scale is None or not e.size:
                continue
            low, high = finding["interval"]
            size = scale * e.size
            work = scale * (e.work or e.size)
            out["sizes"].append(
                {
                    "error": finding["value"] / size - 1.0,
                    "covered": bool(low <= size <= high),
                    "error_work": finding["value"] / work - 1.0,
                    "covered_work": bool(low <= work <= high),
                    "exact": e.exact,
                }
            )
    return out


def stated_limits(verdict: Json) -> dict[str, float]:
    """Detection limits that a verdict states, by column."""
    listed = [*(verdict.get("candidates") or []), *(verdict.get("limits") or [])]
    return {c["name"]: float(c["limit"]) for c in listed if c.get("limit") is not None and np.isfinite(c["limit"])}


def overlaps(true: Truth, verdict: Json, joints: Sequence[str]) -> dict[str, float]:
    """How much columns that were named, or that cannot be told from these, look like the true ones on these runs.

    A candidate by itself takes away the square of the cosine between what is missing and its column, both beside all
    fitted coefficients; the overlap is this cosine over that of the true column. On the ground it is known at one joint
    alone. Nothing where the verdict does not list the true column.
    """
    taken: dict[tuple[str, str | None], float] = {}
    for one in verdict.get("candidates") or []:
        share = min(one["completeness"]) if "completeness" in one else one.get("explained")
        if share is not None:
            # of a law with a shape the best
            at = _column(one["name"], joints)
            taken[at] = max(taken.get(at, 0.0), float(share))
    local = any("explained" in one for one in verdict.get("candidates") or [])
    real = {at: share for at, share in taken.items() if any(e.scale(*at) is not None for e in true.effects)}
    out = {}
    for finding in verdict.get("findings") or []:
        said = [(finding["effect"], finding["joint"]), *(_column(c, joints) for c in finding["cannot_tell_from"])]
        for pair in said:
            most = max((share for at, share in real.items() if not local or at[1] == pair[1]), default=0.0)
            if pair in taken and pair not in real and most > 0.0:
                out[" ".join(x for x in pair if x)] = float(np.sqrt(max(0.0, taken[pair]) / most))
    return out


def multiple(true: Truth, verdict: Json, joints: Sequence[str]) -> float | None:
    """The smallest size of what is hidden over the limit that the verdict itself states; None where it states none."""
    limits: dict[tuple[str, str | None], list[tuple[float, float]]] = {}
    for name, value in stated_limits(verdict).items():
        limits.setdefault(_column(name, joints), []).append((float(name.partition("@")[2] or "nan"), value))
    ratios = []
    for e in true.effects:
        listed = limits.get((e.key, e.joint), [])
        if e.shape is None or any(np.isnan(shape) for shape, _ in listed):
            limit = min((value for _, value in listed), default=0.0)
        else:
            # the shape next to that of the law
            limit = min(((abs(np.log(shape / e.shape)), value) for shape, value in listed), default=(0.0, 0.0))[1]
        if limit > 0.0:
            ratios.append(abs(e.size) / limit)
    return min(ratios) if ratios else None


def as_json(true: Truth) -> dict[str, Any]:
    """The truth as the ledger keeps it."""
    return asdict(true)
