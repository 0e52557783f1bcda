"""The audit: each signal alone, signals compared with each other, and the whole arm."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from zygos import limits
from zygos.arm import ANGLE_STEP, Arm, Encoder, Joint, rounded
from zygos.audit.balance import KINDS, Balance, WholeFault, flattened
from zygos.audit.encoders import pair, unskewed
from zygos.audit.findings import Audit, Pair, Signal, SignalFault, Traffic, signal_names
from zygos.audit.means import Array, Means
from zygos.audit.motors import NOTHING, Change, Motors, changed
from zygos.audit.readings import grid_step, noise_beside, noise_level, runs_of_equal
from zygos.audit.rigid import Reading, RigidLaw
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles
from zygos.runs.samples import segments


def audit(
    arm: Arm, cycles: Cycles, traffic: Traffic | None = None, progress: Callable[[float], None] | None = None
) -> Audit:
    """Audit a run against its arm file. progress is called with the share that is finished.

    Errors: ZygosError if the run has a different number of joints than the arm.
    """
    if cycles.q.shape[1] != arm.n:
        raise ZygosError(
            f"the run has {cycles.q.shape[1]} joints, arm {arm.name} has {arm.n}; remedy: give the arm file with "
            "which the run was made"
        )
    return _Auditor(arm, cycles, traffic or Traffic(), progress or (lambda _: None)).audit()


def _torque_changes(unfit: list[int], use: list[int]) -> Iterator[Change]:
    """The torque of one of the unfit joints inverted, or exchanged with that of another joint in use."""
    for i in unfit:
        yield Change("inverted", "tau", (i,), (i,), -1.0)
    for i, j in itertools.combinations(use, 2):
        if i in unfit or j in unfit:
            yield Change("swapped", "tau", (i, j), (j, i))


class _Auditor:
    """One audit: it collects findings on the signals alone, in pairs, and all together."""

    def __init__(self, arm: Arm, cycles: Cycles, traffic: Traffic, progress: Callable[[float], None]) -> None:
        self.arm, self.cycles, self.traffic, self.progress = arm, cycles, traffic, progress
        self.names = signal_names(arm)
        self.findings: list[SignalFault] = []
        self.notes: list[str] = []
        self.still: list[str] = []
        self.short = False
        self.undecided: set[str] = set()
        self.unfit: list[int] = []
        """Rigid joints whose torque is not explained by the law of a single motor."""
        self.laws: dict[str, float] = {}
        self.pairs: list[Pair] = []
        self._grid: dict[tuple[str, int], float] = {}

    @cached_property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        return segments(self.cycles).ranges

    @cached_property
    def zeros(self) -> dict[str, Array]:
        return {
            "q": np.array([j.link_encoder.zero_rad for j in self.arm.joints]),
            "theta": np.array([j.motor_encoder.zero_rad for j in self.arm.joints]),
        }

    def name(self, kind: str, index: int) -> str:
        return next((n for n, k, i in self.names if (k, i) == (kind, index)), f"{self.arm.joints[index].name} {kind}")

    def find(self, signal: str, fault: str, evidence: str, remedy: str) -> None:
        self.findings.append(SignalFault(signal, fault, evidence, remedy))

    def audit(self) -> Audit:
        self._traffic()
        broken = self._flat()
        self.progress(0.1)
        means = Means(self.arm, self.cycles)
        if means.count:
            self._together(means, broken)
        elif len(self.cycles) == 0:
            self.notes.append(f"no complete cycle of arm {self.arm.name} was received, so nothing can be compared")
            self.undecided |= {name for name, _, _ in self.names}
        else:
            self.notes.append(
                "the run has no part without a gap that is long enough to compare signals with each other "
                f"({4 * self.arm.smoother.points + 4} cycles)"
            )
            self.short = True
            self.undecided |= {name for name, _, _ in self.names}
        self._steps()
        self.progress(1.0)
        signals = tuple(self._signal(*entry) for entry in self.names)
        notes, still = tuple(self.notes), tuple(self.still)
        return Audit(signals, tuple(self.findings), tuple(self.pairs), self.laws, notes, still, self.short)

    def _together(self, means: Means, broken: set[int]) -> None:
        use = []
        for i, joint in enumerate(self.arm.joints):
            if i in broken:
                continue
            if means.moves(i):
                use.append(i)
            else:
                self.notes.append(f"{joint.name}: does not move, so nothing is decided")
                self.still.append(joint.name)
                self.undecided |= {self.name(kind, i) for kind in KINDS}
        if self.arm.grounded and use:
            repaired = self._rigid(use, broken)
            self.progress(0.8)
            balance = self._balance(repaired, broken)
            if balance is not None:
                self._torque_law(balance, {})
                self._smoother(balance)
            return
        repaired, motors, clean = self._motors(use, means, broken)
        self.progress(0.4)
        if not use:
            self._no_balance("no joint with working signals moves")
            return
        balance = self._balance(repaired, broken)
        balance = self._coupled(balance, motors)
        if balance is not None and self.arm.free:
            balance = self._whole(balance)
        self.progress(0.8)
        skewed = self._pairs(motors, clean, balance)
        if balance is not None:
            self._torque_law(balance, skewed)
            self._smoother(balance)

    # -- each signal alone

    def _traffic(self) -> None:
        measured = self.traffic.period_s
        if math.isfinite(measured) and abs(measured / self.arm.period_s - 1.0) > limits.PERIOD_OFF.value:
            self.find(
                "SYNC",
                f"every {1e3 * measured:.4g} ms, not {1e3 * self.arm.period_s:.4g} ms",
                "FTIME compared with the count of SYNCs",
                f"period_s = {measured:.6g}",
            )
        for name, _, _ in self.names:
            share = self._share(name)
            if share < 1.0 - limits.LOST.value:
                self.find(
                    name,
                    "missing" if share == 0.0 else f"loses {100 * (1 - share):.1f} %",
                    f"{100 * share:.1f} % of the cycles",
                    "compare the node numbers of the arm file with the bus"
                    if share == 0.0
                    else "repair the bus or the recording",
                )
            count = self.traffic.saturated.get(name, 0)
            if count:
                self.find(
                    name,
                    "saturated",
                    f"{count} frames at the end of the CAN signal's range",
                    "use a sensor with a larger range",
                )

    def _share(self, name: str) -> float:
        if name in self.traffic.share:
            return self.traffic.share[name]
        if not self.ranges:
            return 0.0
        used = sum(b - a for a, b in self.ranges)
        first, last = int(self.cycles.sync[self.ranges[0][0]]), int(self.cycles.sync[self.ranges[-1][1] - 1])
        return used / max(last - first + 1, 1)

    def _flat(self) -> set[int]:
        """Report stuck or saturated signals; returns the joints that cannot be used because of them (-1: the gyro)."""
        broken = set()
        for name, kind, i in self.names:
            if kind == "omega" and not self._used_axis(i):
                continue
            verdict = self._flat_one(kind, i)
            if verdict is not None:
                fault, evidence = verdict
                if not any(f.signal == name and f.fault == fault for f in self.findings):
                    remedy = "repair the sensor or its telemetry"
                    if fault == "saturated":
                        remedy = (
                            "use a sensor with a larger range, or a slower motion; nothing if the drive stops there"
                        )
                    self.find(name, fault, evidence, remedy)
                broken.add(-1 if kind == "omega" else i)
        return broken

    def _flat_one(self, kind: str, i: int) -> tuple[str, str] | None:
        readings: Array = getattr(self.cycles, kind)[:, i]
        flat = runs_of_equal(readings, self.ranges, limits.FLAT_TOP_CYCLES.value)
        if not flat:
            return None
        valid = np.concatenate([readings[a:b] for a, b in self.ranges])
        ends = (float(valid.min()), float(valid.max()))
        moving = [(a, b) for a, b in flat if self._partner_moves(kind, i, a, b)]
        if ends[0] < ends[1]:
            for end in ends:
                tops = [(a, b) for a, b in flat if readings[a] == end]
                # at a turning point the code of an encoder is constant; there the partner must continue to move
                tops = tops if kind in ("tau", "omega") else [t for t in tops if t in moving]
                length = sum(b - a for a, b in tops)
                if len(tops) >= limits.FLAT_TOPS.value and length > limits.FLAT_TOP.value * len(valid):
                    return "saturated", f"{length} cycles at {end:.6g}, in {len(tops)} runs"
        stuck = [
            (a, b)
            for a, b in moving
            if b - a >= limits.FLAT_CYCLES.value and not (kind == "tau" and readings[a] == 0.0)
        ]
        if ends[0] == ends[1]:
            stuck = moving
        if stuck:
            a, b = max(stuck, key=lambda r: r[1] - r[0])
            fault = "saturated" if ends[0] < ends[1] and readings[a] in ends else "stuck"
            return fault, f"{b - a} cycles at {readings[a]:.6g}, starting at cycle {int(self.cycles.sync[a])}"
        return None

    def _partner_moves(self, kind: str, i: int, a: int, b: int) -> bool:
        """Whether the partner of a signal moves between a and b, far enough that the signal should move as well."""
        joints = range(self.arm.n) if kind == "omega" else (i,)
        for j in joints:
            joint = self.arm.joints[j]
            partners = {"q": ("theta",), "theta": ("q",) if joint.flexible else (), "tau": ("theta",)}.get(
                kind, ("theta",)
            )
            for partner in partners:
                readings: Array = getattr(self.cycles, partner)[:, j]
                quanta = limits.FLAT_QUANTA.value * (self._step("q", j) + self._step("theta", j))
                whole = max(float(np.ptp(readings[c:d])) for c, d in self.ranges)
                if float(np.ptp(readings[a:b])) > max(quanta, limits.FLAT.value * whole):
                    return True
        return False

    def _encoder(self, kind: str, i: int) -> Encoder:
        joint: Joint = self.arm.joints[i]
        return joint.link_encoder if kind == "q" else joint.motor_encoder

    def _step(self, kind: str, i: int) -> float:
        """The larger one of an encoder's declared step and its observed step, rad."""
        seen = self._seen_step(kind, i)
        return max(self._encoder(kind, i).quantum_rad, seen if math.isfinite(seen) else 0.0)

    def _seen_step(self, kind: str, i: int) -> float:
        if (kind, i) not in self._grid:
            self._grid[kind, i] = grid_step(getattr(self.cycles, kind)[:, i], self.ranges, ANGLE_STEP)
        return self._grid[kind, i]

    def _steps(self) -> None:
        for name, kind, i in self.names:
            if kind not in ("q", "theta") or any(
                f.signal == name and f.fault.startswith("scaled") for f in self.findings
            ):
                continue
            encoder, readings = self._encoder(kind, i), getattr(self.cycles, kind)[:, i]
            step = self._seen_step(kind, i)
            quantum = encoder.quantum_rad
            noise = noise_level(readings, self.ranges)
            declared = self._declared_noise(kind, i)
            interpolated = step < quantum and noise >= limits.AS_NOISY.value * declared
            if (
                math.isfinite(step)
                and abs(step / max(quantum, ANGLE_STEP) - 1.0) > limits.STEP_OFF.value
                and not interpolated
            ):
                self.find(
                    name,
                    f"moves in steps of 2π/{2 * math.pi / step:.0f}, not 2π/{2 * math.pi / quantum:.0f}",
                    f"{step:.4g} rad, declared {quantum:.4g} rad",
                    f"quantum_rad = {step:.6g}",
                )
                continue
            if noise > limits.NOISE_OFF.value * declared:
                self.find(
                    name,
                    f"noisier than declared by a factor of {noise / declared:.1f}",
                    f"{noise:.2g} rad, declared {declared:.2g} rad",
                    "repair the sensor, or state its actual counts (quantum_rad)",
                )
        # a torque's own noise cannot be separated from the encoder noise that a controller passes on, if the controller
        # reads different values
        spoilt = ("moves in steps", "noisier", "stuck", "saturated")
        if any(f.fault.startswith(spoilt) and f.signal.endswith("angle") for f in self.findings):
            return
        # nor can it if an encoder is not read at SYNC, at which the controller reads it
        skewed = {f.signal for f in self.findings if f.fault.startswith("skewed")}
        late = {i for name, _, i in self.names if name in skewed}
        late |= {
            i
            for i, joint in enumerate(self.arm.joints)
            if joint.latch_us + joint.link_encoder.latch_us + joint.motor_encoder.latch_us > 0
        }
        for name, kind, i in self.names:
            decided = name not in self.undecided and i not in late
            if kind == "tau" and decided and not any(f.signal == name for f in self.findings):
                self._torque_noise(name, i)

    def _noise(self, kind: str, i: int) -> float:
        """Noise of a signal; for a torque without the part that a controller derives from the noise of encoders and
        gyro."""
        readings: Array = getattr(self.cycles, kind)[:, i]
        if kind != "tau":
            return noise_level(readings, self.ranges)
        others = np.hstack([self.cycles.theta, self.cycles.q, self.cycles.omega])
        return noise_beside(readings, others, self.ranges)

    def _torque_noise(self, name: str, i: int) -> None:
        sigma, readings = self.arm.joints[i].torque_sigma, self.cycles.tau[:, i]
        own, whole, unit = self._noise("tau", i), noise_level(readings, self.ranges), self.arm.torque_unit
        declared = self.arm.over_the_wire.joints[i].torque_sigma
        valid = np.concatenate([readings[a:b] for a, b in self.ranges] or [np.zeros(1)])
        if not own > max(limits.NOISE_OFF.value * declared, limits.TORQUE_NOISE_SEEN.value * float(np.std(valid))):
            return
        if limits.FOLLOWS.value < own / whole < limits.ALONE.value:
            self.notes.append(
                f"{name}: changes from cycle to cycle by {whole:.2g} {unit}, and "
                f"{100 * (1 - (own / whole) ** 2):.0f} % of the variance is correlated with the readings of "
                "encoders and gyro: either a controller that reads "
                f"different values applies this torque, or the torque is noisier than declared ({sigma:.2g} {unit})"
            )
            return
        self.find(
            name,
            f"noisier than declared by a factor of {own / sigma:.1f}"
            if sigma > 0.0
            else "noisy, and no noise is declared",
            f"{own:.2g} {unit}, declared {sigma:.2g} {unit}, without the part that follows the noise of encoders and "
            "gyro",
            f"torque_sigma = {own:.2g} of the joint; nothing if the drive really applies torques that change so much "
            "from cycle to cycle",
        )

    def _declared_noise(self, kind: str, i: int) -> float:
        if kind == "tau":
            return self.arm.joints[i].torque_sigma
        if kind == "omega":
            return self.arm.over_the_wire.imu.rate_sigma
        # readings need not lie on the grid that the arm file declares
        return rounded(self._encoder(kind, i).sigma_rad, ANGLE_STEP)

    def _used_axis(self, axis: int) -> bool:
        """Whether the arm turns about this axis of the gyro."""
        if not self.arm.free:
            return False
        return self.arm.spatial or abs(float((self.arm.mount.T @ self.arm.axis)[axis])) > 1e-6

    # -- signals compared with each other

    def _motors(self, use: list[int], means: Means, broken: set[int]) -> tuple[Cycles, Motors, list[int]]:
        """Report faults of angles and torques one after the other; each is corrected before the next is searched.
        Returns the corrected run and the joints in which nothing was wrong."""
        cycles, touched = self.cycles, set()
        motors = Motors(means, use)
        for _ in range(3 * len(use)):
            now = motors.total(NOTHING)
            ranked = sorted(((motors.total(c), k, c) for k, c in enumerate(motors.changes())), key=lambda r: r[:2])
            held = [
                r
                for r in ranked
                if now - r[0] < math.log(limits.AUDIT_SURE.value) or self._holds(motors, r[2], cycles, broken)
            ]
            if not held or now - held[0][0] < math.log(limits.AUDIT_SURE.value):
                self._doubt(motors, ranked[0][2] if ranked and ranked[0] not in held else NOTHING)
                break
            ranked = held
            total, _, change = ranked[0]
            rivals = [
                r[2]
                for r in ranked[1:]
                if r[0] - total < math.log(limits.AUDIT_SURE.value) and set(r[2].joints) & set(change.joints)
            ]
            if change.what == "scaled":
                # the scale of a motor's law is unknown: the wrong angle is the one whose noise differs from the
                # declared
                alike = sorted(
                    (self._noise_off(c), k, c) for k, c in enumerate([change, *rivals]) if c.what == "scaled"
                )
                change = alike[0][2]
                rivals = [c for off, _, c in alike[1:] if off - alike[0][0] < math.log(limits.NOISE_OFF.value)]
            self._name(change, math.exp(now - total), rivals[0] if rivals else None)
            touched |= set(change.joints)
            cycles = changed(cycles, change, self.zeros)
            means = Means(self.arm, cycles)
            motors = Motors(means, use)
        for i in use:
            joint = self.arm.joints[i]
            if i in touched:
                continue
            if motors.left(i, NOTHING) > limits.MOTOR_FITS.value and not joint.flexible and len(use) > 1:
                self.unfit.append(i)
                continue
            here = motors.score(i, NOTHING)
            turned = motors.score(i, Change("inverted", "tau", (i,), (i,), -1.0))
            if turned - here < math.log(limits.AUDIT_SURE.value) or math.exp(here) > limits.SIGN_EXPLAINED.value:
                self.undecided.add(self.name("tau", i))
                self.notes.append(
                    f"{joint.name}: the sign of the torque is not decided "
                    f"(inverted, it is explained {math.exp(here - turned):.2f} times as well)"
                )
            if joint.flexible and motors.stiff[i]:
                self.notes.append(f"{joint.name}: too stiff to decide whether motor and link encoder are exchanged")
        return cycles, motors, [i for i in use if i not in touched]

    def _rigid(self, use: list[int], broken: set[int]) -> Cycles:
        """Decide signs, places and scales of the readings of an arm with a fixed base and rigid joints by the law of
        the whole arm; returns the run after correction."""
        law = RigidLaw(self.arm, self.cycles, broken)
        names = {self.name("tau", i) for i in use}
        if not law.enough:
            self.undecided |= names
            self.short = True
            self.notes.append(
                "signs and places of the torques are not decided: the run is too short for the law of the whole arm, "
                f"which has {law.unknown} parameters"
            )
            return self.cycles
        declared = Reading.declared(self.arm.n)
        if self.currents:
            declared = law.with_fitted_scales(declared, use)
        best = self._best_reading(law, declared, use)
        self.progress(0.7)
        kept = declared
        if best != declared and self._closes(law, best, use):
            self._name_reading(law, declared, best)
            kept = best
        self._confirm_readings(law, kept, [i for i in use if i not in declared.differs(kept)])
        return self._reread(kept)

    @property
    def currents(self) -> bool:
        """Whether torques are motor currents, so that the scale of each torque is unknown and no fault."""
        return self.arm.torque_unit == "A"

    def _closes(self, law: RigidLaw, reading: Reading, use: list[int]) -> bool:
        share = law.score(reading).share[[i for i in use if i in law.with_rows]]
        return bool(np.all(share <= limits.AUDIT_CLOSES.value))

    def _best_reading(self, law: RigidLaw, declared: Reading, use: list[int]) -> Reading:
        """The hypothesis to which each step is clearly better than the one before."""

        def best_of(trials: Iterator[Reading]) -> Reading:
            return min(trials, key=lambda one: law.score(one).total)

        now = declared
        for _ in range(3 * len(use)):
            best = best_of(law.torque_changes(now, use))
            if not self._clearly(law, now, best, limits.AUDIT_SURE.value):
                break
            now = best
        if not self._closes(law, now, use):
            # the columns of each angle change take long, so that these come only where no torque is the reason
            best = best_of(law.angle_changes(declared, use))
            if self._clearly(law, now, best, limits.AUDIT_SURE.value) and self._closes(law, best, use):
                now = best
        if self.currents:
            return min(declared, now, key=lambda one: law.score(one).total)
        # a torque of a wrong scale may look inverted, so that scales are also tried on the arm file's own readings
        ends = [self._with_scales(law, start, use) for start in dict.fromkeys((declared, now))]
        return min(ends, key=lambda one: law.score(one).total)

    def _with_scales(self, law: RigidLaw, reading: Reading, use: list[int]) -> Reading:
        """The hypothesis with each scale that is clearly better, the best one first: a wrong scale of one torque lets
        those of others seem wrong."""
        now = reading
        for _ in use:
            tried = [(law.rescaled(now, i), i) for i in use if now.factor[i] == reading.factor[i]]
            better = [
                one
                for one, i in tried
                if abs(math.log(abs(one.factor[i] / now.factor[i]))) > math.log(limits.SCALE_OFF.value)
                and self._clearly(law, now, one, limits.SURE_SCALE.value)
            ]
            if not better:
                break
            now = min(better, key=lambda one: law.score(one).total)
        return now

    @staticmethod
    def _clearly(law: RigidLaw, one: Reading, other: Reading, factor: float) -> bool:
        """Whether the second hypothesis is better by that factor for each joint that it changes."""
        changes = max(len(one.differs(other)), 1)
        before, after = law.score(one).total, law.score(other).total
        return math.isfinite(after) and before - after >= changes * math.log(factor)

    def _name_reading(self, law: RigidLaw, declared: Reading, best: Reading) -> None:
        before, after = law.score(declared), law.score(best)
        for i in declared.differs(best):
            evidence = (
                f"the law of the whole arm leaves {100 * after.share[i]:.2g} % of this torque unexplained, and "
                f"{100 * before.share[i]:.2g} % as the arm file says"
            )
            name, ratio = self.name("tau", i), float(self.arm.gear_ratios[i])
            factor = best.factor[i]
            if i in best.turned:
                sign = -self.arm.joints[i].motor_encoder.sign
                remedy = f"sign = {sign} of the motor_encoder, or reverse axis of the joint"
                self.find(self.name("theta", i), "inverted", evidence, remedy)
            if best.source[i] != i:
                self.find(
                    name,
                    f"swapped with {self.name('tau', best.source[i])}" + (" and inverted" if factor < 0.0 else ""),
                    evidence,
                    "exchange the names (or nodes) of the two where the log is written",
                )
            elif factor < 0.0:
                self.find(name, "inverted", evidence, "change its sign where the log is written")
            if abs(factor) != 1.0 and not self.currents:
                self.find(
                    name,
                    f"scaled by {1.0 / abs(factor):.4g}",
                    evidence,
                    f"gear_ratio = {ratio * abs(factor):.4g} of the joint, or correct the unit or the torque constant "
                    "where the log is written",
                )

    def _confirm_readings(self, law: RigidLaw, kept: Reading, use: list[int]) -> None:
        """Note which signs and places the law does not confirm."""
        now = law.score(kept)
        for i in use:
            name, left = self.name("tau", i), float(now.share[i])
            if not left <= limits.MOTOR_FITS.value:
                self.undecided.add(name)
                self.notes.append(
                    f"{name}: sign and place are not decided (the law of the whole arm leaves {100 * left:.0f} % of "
                    "the torque unexplained)"
                )
        for other in law.torque_changes(kept, use):
            better = now.total - law.score(other).total
            changes = kept.differs(other)
            if (
                -better < len(changes) * math.log(limits.AUDIT_SURE.value)
                and not {self.name("tau", i) for i in changes} <= self.undecided
            ):
                self.undecided |= {self.name("tau", i) for i in changes}
                what = "inverted" if other.source == kept.source else "swapped"
                self.notes.append(
                    f"{' and '.join(self.name('tau', i) for i in changes)}: "
                    f"{'sign is' if what == 'inverted' else 'places are'} not decided ({what}, the law of the whole "
                    f"arm explains the torques {math.exp(better / len(changes)):.2f} times as well)"
                )

    def _reread(self, reading: Reading) -> Cycles:
        """The run under a hypothesis."""
        theta = self.cycles.theta.copy()
        for i in reading.turned:
            theta[:, i] = 2.0 * self.zeros["theta"][i] - theta[:, i]
        tau = self.cycles.tau[:, list(reading.source)] * np.array(reading.factor)
        return replace(self.cycles, q=np.where([not j.flexible for j in self.arm.joints], theta, self.cycles.q),
                       theta=theta, tau=tau)  # fmt: skip

    def _holds(self, motors: Motors, change: Change, cycles: Cycles, broken: set[int]) -> bool:
        """Whether the best change is accepted: the motors' laws must fit after it, and where they do not fit well, the
        balance of the whole arm, if there is one, must not contradict."""
        if change.kind != "tau" and all(motors.stiff[i] for i in change.joints):
            return True  # the two rates are sufficient evidence
        left = max(motors.left(i, change) for i in change.joints)
        if left > limits.MOTOR_FITS.value:
            return False
        if left <= limits.MOTOR_FITS_WELL.value or change.kind != "tau" or broken:
            return True
        try:
            balance = Balance(self.arm, cycles)
        except ZygosError:
            return True
        # if both residuals are infinite, the comparison is False, and the law alone decides
        return (
            not balance.residual(self.arm, changed(balance.cycles, change, self.zeros))
            > limits.AUDIT_SURE.value * balance.residual_j
        )

    def _doubt(self, motors: Motors, change: Change) -> None:
        """Note that a change of flexible joints would explain the run better, but is not proven."""
        for i in change.joints:
            if self.arm.joints[i].flexible:
                self.undecided.add(self.name(change.kind or "theta", i))
                self.notes.append(
                    f"{self.arm.joints[i].name}: {self._called(change)} would explain the run better, but even then "
                    f"the law of the motor leaves {100 * motors.left(i, change):.0f} % of the torque unexplained, or "
                    "the energy balance contradicts; it is therefore not reported as a fault"
                )

    def _noise_off(self, change: Change) -> float:
        """Distance of an angle's noise, after correction of its scale, from the declared one: logarithm of the
        ratio."""
        i = change.joints[0]
        noise = change.factor * noise_level(getattr(self.cycles, change.kind)[:, i], self.ranges)
        return abs(math.log(max(noise, 1e-300) / self._declared_noise(change.kind, i)))

    def _name(self, change: Change, ratio: float, rival: Change | None, *, whole: bool = False) -> None:
        """whole: the evidence is the balance of the whole arm."""
        evidence = f"{'the energy balance closes' if whole else 'explains the run'} {ratio:.3g} times better"
        if rival is not None:
            evidence += f"; {self._called(rival)} would explain it equally well"
        if change.what == "exchanged":
            i = change.joints[0]
            for kind, other in (("q", "theta"), ("theta", "q")):
                self.find(
                    self.name(kind, i),
                    f"swapped with {self.name(other, i)}",
                    evidence,
                    "exchange link and motor encoder where the log is written",
                )
        elif change.what == "swapped":
            for i, j in zip(change.joints, change.source, strict=True):
                self.find(
                    self.name(change.kind, i),
                    f"swapped with {self.name(change.kind, j)}",
                    evidence,
                    "exchange the names (or nodes) of the two where the log is written",
                )
        elif change.what == "inverted":
            remedy = "change its sign where the log is written"
            if change.kind != "tau":
                encoder = self._encoder(change.kind, change.joints[0])
                remedy = f"sign = {-encoder.sign} of the {'link' if change.kind == 'q' else 'motor'}_encoder"
            self.find(self.name(change.kind, change.joints[0]), "inverted", evidence, remedy)
        else:
            self.find(
                self.name(change.kind, change.joints[0]),
                f"scaled by {1.0 / change.factor:.4g}",
                evidence,
                "angles are after the gear: divide by the gear ratio once, where the log is written",
            )

    def _called(self, change: Change) -> str:
        who = " and ".join(self.name(change.kind or "theta", i) for i in change.joints)
        return f"{who} {change.what}"

    def _pairs(self, motors: Motors, clean: list[int], balance: Balance | None) -> dict[int, float]:
        """Audit the encoder pairs; returns the skews that were reported, s."""
        named: dict[int, float] = {}
        found = {i: pair(motors.means, i, motors.stiff[i]) for i in clean if self.arm.joints[i].flexible}
        self.pairs = list(found.values())
        wanted = {
            i: p.skew_s
            for i, p in found.items()
            if abs(p.skew_s) > max(limits.SKEW_Z.value * p.skew_sigma_s, limits.SKEW.value * self.arm.period_s)
        }
        for i, one in found.items():
            joint = self.arm.joints[i]
            if i in wanted:
                if self._is_friction(i, one, wanted, balance):
                    late = f"{1e3 * abs(one.skew_s):.3g} ms ± {1e3 * one.skew_sigma_s:.1g}"
                    why = "viscous friction of the motor and not a skew: with a latch the energy balance closes worse"
                    if balance is None:
                        why = "a newer link encoder or viscous friction of the motor, which only a balance could decide"
                    self.notes.append(f"{joint.name}: {late} between the encoders are {why}")
                else:
                    named[i] = one.skew_s
                    self._name_skew(joint, one)
            first, second = joint.link_encoder, joint.motor_encoder
            allowed = 3.0 * math.hypot(first.zero_sigma_rad, second.zero_sigma_rad)
            allowed += first.quantum_rad + second.quantum_rad + limits.ZERO_Z.value * one.zero_sigma_rad
            if abs(one.zero_rad) > allowed:
                self.find(
                    self.name("q", i),
                    f"zero off by {1e3 * -one.zero_rad:.3g} mrad ± {1e3 * one.zero_sigma_rad:.1g}",
                    f"{abs(one.zero_rad) / max(one.zero_sigma_rad, 1e-300):.1f} standard errors",
                    f"zero_rad = {first.zero_rad - first.sign * one.zero_rad:.6g} of the link_encoder, or the same "
                    "change in the opposite direction of the motor_encoder; a bias of the torque looks the same",
                )
        return named

    def _is_friction(self, i: int, one: Pair, wanted: dict[int, float], balance: Balance | None) -> bool:
        """Whether the apparent skew of a newer link encoder is viscous friction of the motor.

        For a soft joint, s = n tau - Im n^2 thetadd - friction: friction that grows with the rate reduces theta - q as
        a newer link encoder does. The balance of the whole arm includes friction, and closes worse with a latch that is
        not real.
        """
        if one.stiff or one.skew_s > 0.0:
            return False
        if balance is None:
            return True
        others = {j: skew for j, skew in wanted.items() if j != i}
        without = balance.residual(unskewed(self.arm, others), balance.cycles)
        return not balance.residual(unskewed(self.arm, wanted), balance.cycles) < without

    def _name_skew(self, joint: Joint, found: Pair) -> None:
        newer, older = ("motor", "link") if found.skew_s > 0 else ("link", "motor")
        encoder = joint.motor_encoder if newer == "motor" else joint.link_encoder
        latch = encoder.latch_us + 1e6 * abs(found.skew_s)
        self.find(
            f"{joint.name} {newer} angle",
            f"skewed {1e3 * abs(found.skew_s):.3g} ms ± {1e3 * found.skew_sigma_s:.1g}",
            f"newer than the {older} angle, {abs(found.skew_s) / found.skew_sigma_s:.0f} standard errors",
            f"latch_us = {latch:.0f} of the {newer}_encoder; if instead the {older} angle is old, torque and gyro are "
            "newer as well",
        )

    # -- the whole arm

    def _coupled(self, balance: Balance | None, motors: Motors) -> Balance | None:
        """Decide signs and places of torques that no motor's law explains, by the balance of the whole arm, which
        includes the coupling of the joints; returns the balance after correction of the reported fault."""
        if not self.unfit:
            return balance
        left = ", ".join(f"{self.arm.joints[i].name} {100 * motors.left(i, NOTHING):.0f} %" for i in self.unfit)
        problem = f"the law of a single motor does not fit, it leaves unexplained: {left} of the torque"
        names = {self.name("tau", i) for i in self.unfit}
        if balance is None:
            self.undecided |= names
            self.notes.append(f"{problem}; signs and places of these torques are not decided")
            return None
        now = balance.residual_j
        trials = sorted(
            (
                (balance.residual(self.arm, changed(balance.cycles, change, self.zeros)), k, change)
                for k, change in enumerate(_torque_changes(self.unfit, motors.use))
            ),
            key=lambda trial: trial[:2],
        )
        best, _, change = trials[0]
        if now / best >= limits.AUDIT_SURE.value:
            # with all torques inverted the balance is the same, so it cannot decide which one of two is wrong
            rival = next((c for value, _, c in trials[1:] if value / best < limits.SURE_LAW.value), None)
            self._name(change, now / best, rival, whole=True)
            return Balance(self.arm, changed(balance.cycles, change, self.zeros))
        if best / now < limits.AUDIT_SURE.value:
            self.undecided |= names
            self.notes.append(
                f"{problem}; signs and places of these torques are not decided ({self._called(change)}, the energy "
                f"balance of the whole arm closes {now / best:.2f} times as well)"
            )
        else:
            self.notes.append(
                f"{problem}; the energy balance of the whole arm, which includes their coupling, confirms signs and "
                f"places (any change closes it worse by {best / now:.2g} or more), except for an inversion of all "
                "torques together"
            )
        return balance

    def _no_balance(self, why: str) -> None:
        self.notes.append(f"torque law and gyro are not decided: {why}")
        self.undecided |= {name for name, kind, i in self.names if kind == "omega" and self._used_axis(i)}

    def _balance(self, cycles: Cycles, broken: set[int]) -> Balance | None:
        if broken:
            self._no_balance("stuck or saturated signals make the balance of the whole arm useless")
            return None
        try:
            balance = Balance(self.arm, cycles)
        except ZygosError as error:
            self._no_balance(str(error).split("; remedy")[0])
            return None
        if not math.isfinite(balance.residual_j):
            self.short |= balance.few
            self._no_balance(f"the run has no balance of the whole arm ({balance.reason})")
            return None
        return balance

    def _whole(self, balance: Balance) -> Balance:
        """Report a fault of the gyro or of a whole joint; returns the balance after its correction."""
        now = balance.residual_j
        trials = list(balance.trials(self.zeros))
        residual, best = min(trials, key=lambda trial: trial[0])
        if now / residual >= limits.AUDIT_SURE.value:
            self._name_whole(best, f"the energy balance closes {now / residual:.3g} times better")
            return Balance(self.arm, best.cycles)
        against = min(value for value, fault in trials if fault.what == "gyro")
        if against / now < limits.AUDIT_SURE.value:
            self.undecided |= {name for name, kind, i in self.names if kind == "omega" and self._used_axis(i)}
            self.notes.append(
                f"gyro: signs and axes are not decided (after a change, the energy balance closes "
                f"{now / against:.2f} times as well)"
            )
        return balance

    def _name_whole(self, fault: WholeFault, evidence: str) -> None:
        if fault.what == "gyro":
            for i in range(3):
                source = int(np.argmax(np.abs(fault.turn[i])))
                sign = fault.turn[i, source]
                if source == i and sign > 0:
                    continue
                if not (self._used_axis(i) or self._used_axis(source)):
                    continue
                fault_text = "inverted" if source == i else f"swapped with gyro {'xyz'[source]}"
                fault_text += " and inverted" if source != i and sign < 0 else ""
                self.find(
                    f"gyro {'xyz'[i]}",
                    fault_text,
                    evidence,
                    "correct mount_xyzw of the arm file, or the signs where the log is written",
                )
            return
        for i in fault.joints:
            fault_text, remedy = "inverted, as all signals of the joint", "reverse axis of the joint"
            if fault.what == "swapped":
                other = self.arm.joints[sum(fault.joints) - i].name
                fault_text, remedy = (
                    f"swapped with {other}'s, as all signals of the joint",
                    "exchange the nodes of the two joints",
                )
            for kind in KINDS if self.arm.joints[i].flexible else KINDS[1:]:
                self.find(self.name(kind, i), fault_text, evidence, remedy)

    def _torque_law(self, balance: Balance, skewed: dict[int, float]) -> None:
        self.laws = balance.laws(unskewed(self.arm, skewed))
        first, second, _ = sorted(self.laws, key=lambda law: self.laws[law])
        declared, best, next_best = (self.laws[law] for law in (self.arm.torque_law, first, second))
        if skewed:
            self.notes.append("torque_law: can be decided only after the skew of the encoders is corrected")
        elif declared / best >= limits.SURE_LAW.value:
            self.find(
                "torques",
                f"not {self.arm.torque_law}",
                f"the energy balance closes {declared / best:.3g} times better",
                f'torque_law = "{first}", unless the drives have a delay of that size',
            )
        elif first != self.arm.torque_law or next_best / best < limits.LIKELY_LAW.value:
            self.notes.append(
                f"torque_law: not decided ({second} closes the energy balance {best / next_best:.2f} times as well as "
                f"{first})"
            )

    def _smoother(self, balance: Balance) -> None:
        """Report a smoother that takes more off the motion than the intervals contain; in a run that has no other
        fault, which would move the values as well."""
        if self.findings:
            return
        found = flattened(self.arm, self.cycles, balance.friction)
        if found is None or found.sigmas < limits.FLATTENED_Z.value:
            return
        other = found.smoother
        self.find(
            "smoother",
            f"of order {self.arm.smoother.order} flattens the motion",
            f"with order {other.order} in a window of {other.points} points, {found.parameter} moves by "
            f"{found.sigmas:.2g} standard deviations: the intervals are too narrow",
            f"order = {other.order} and points = {other.points} in [smoother], or slower motion",
        )

    # -- the table

    def _signal(self, name: str, kind: str, i: int) -> Signal:
        readings: Array = getattr(self.cycles, kind)[:, i]
        valid = np.concatenate([readings[a:b] for a, b in self.ranges] or [np.full(1, math.nan)])
        angle = kind in ("q", "theta")
        faults = [f.fault for f in self.findings if f.signal == name]
        decided = name not in self.undecided or bool(faults)
        return Signal(
            name=name,
            unit={"tau": self.arm.torque_unit, "omega": "rad/s"}.get(kind, "rad"),
            share=self._share(name),
            low=float(valid.min()),
            high=float(valid.max()),
            step=self._seen_step(kind, i) if angle else math.nan,
            quantum=self._encoder(kind, i).quantum_rad if angle else math.nan,
            noise=self._noise(kind, i),
            declared=self._declared_noise(kind, i),
            decided=decided,
            verdict="; ".join(faults) or ("ok" if decided else "not decidable"),
        )
