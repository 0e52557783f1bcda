"""From two runs and a simulation to a verdict: what is missing, where, how much, and what the gap is with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from zygos.arm import Arm
from zygos.dynamics.planar import PlanarDynamics
from zygos.effects import CATALOGUE, OFFSET, Effect, is_column, spoken
from zygos.errors import Undecided, ZygosError
from zygos.gap.balances import Layout
from zygos.gap.experiment import Experiment, propose
from zygos.gap.fit import fit
from zygos.gap.forecast import Forecast, Stretches, cut, cut_twin, forecast
from zygos.gap.record import MeasuredRun
from zygos.gap.search import CERTAIN, COMPLETE, EXCESS, PARTLY, Candidate, Search, excess, search
from zygos.gap.study import Study, again, begin, read_hypothesis, realise, split
from zygos.gap.twin import follow
from zygos.model.model import Model, Quantity

Array = NDArray[np.float64]
Answer = Literal["nothing missing", "values differ", "named", "cannot tell", "unknown"]

INTERVAL = float(norm.ppf(0.975))
"""Standard deviations of a 95 % interval."""
DIFFERS = 3.0
"""Standard deviations by which a value differs from the simulation's."""
DISAGREE = 4.5
"""Standard deviations by which the runs may not disagree on a value."""
MATERIAL = 0.005
"""Share below which a difference of values does not matter."""
_USED = 0.9
"""Share of a run below which its losses are worth a word."""
_DEFLECTED = 3.0
"""Deviations of the encoders beyond which a joint that is said to be rigid is not."""
_ALIKE = 1.0 / 3.0
"""Share of the worst balance's ratio from which on another balance fails about as much."""
_SKEWED = 0.95
"""Share of a deflection that goes with the joint's rate: then it is a matter of the encoders' timing."""


@dataclass(frozen=True)
class Value:
    """A base parameter, or an effect that the simulation knows: what it had, and what the runs say."""

    name: str
    unit: str
    delivered: float
    delivered_sigma: float
    found: float
    sigma: float

    @property
    def change(self) -> float:
        """Relative difference."""
        return self.found / self.delivered - 1.0 if self.delivered and np.isfinite(self.delivered) else np.nan

    @property
    def absent(self) -> bool:
        """Whether it is an effect of which the runs show nothing."""
        return is_column(self.name) and abs(self.found) < DIFFERS * self.sigma

    @property
    def differs(self) -> bool:
        """Whether the two are further apart than their deviations and their sizes allow."""
        apart = abs(self.found - self.delivered)
        return bool(
            np.isfinite(apart)
            and apart > DIFFERS * np.hypot(self.sigma, self.delivered_sigma)
            and apart > MATERIAL * abs(self.delivered)
        )


@dataclass(frozen=True)
class Finding:
    """An effect that the simulation lacks."""

    kind: str
    """Name in the catalogue, or joint_flexibility."""
    title: str
    joint: str | None
    value: float
    sigma: float
    unit: str
    evidence: str
    instead: tuple[str, ...] = ()
    """Columns that the runs cannot tell from it."""

    @property
    def place(self) -> str:
        """Where, in words."""
        return "the base" if self.joint is None else self.joint

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return self.value - INTERVAL * self.sigma, self.value + INTERVAL * self.sigma


@dataclass(frozen=True)
class Deflection:
    """A joint that the simulation takes as rigid."""

    joint: str
    rms_rad: float
    noise_rad: float
    skew_s: float
    skew_share: float
    """Share of the deflection's variance that a delay between the encoders would explain."""


@dataclass(frozen=True)
class Gap:
    """Predictions of the untouched run; all in units of the sensors' declared noise."""

    segments: Stretches
    delivered: Forecast
    refit: Forecast
    closed: Forecast
    floor: Forecast
    struck: Forecast | None
    """The closed model with the named effects of the catalogue struck out; None where none was."""
    wrong: Forecast | None
    """With the best other candidate in place of the named effect."""
    wrong_name: str


@dataclass(frozen=True)
class Explanation:
    """Everything that is known in the end."""

    arm: Arm
    simulation: Model
    answer: Answer
    sentence: str
    where: str
    refit: Study
    """The simulation's own equations, its values fitted."""
    search: Search | None
    """Where the simulation lacks the joints' flexibility, what is searched is what it lacks beside."""
    findings: tuple[Finding, ...]
    partly: str
    """With an unknown effect, what part of it looks like."""
    values: tuple[Value, ...]
    deflections: tuple[Deflection, ...]
    experiments: tuple[Experiment, ...]
    gap: Gap | None
    local: Array
    """(runs, balances) rho of each balance by itself, before."""
    model: Model | None
    """The model with what was learned; None where nothing is to be adopted."""
    remarks: tuple[str, ...]

    @property
    def closed(self) -> Study:
        """The runs with everything that was named."""
        return self.search.after if self.search is not None else self.refit


def explain(
    arm: Arm,
    simulation: Model,
    measured: Sequence[MeasuredRun],
    validate: MeasuredRun | None,
    step: Callable[[float, str], None] = lambda share, what: None,
) -> Explanation:
    """Say what a simulation lacks. step is told the share done and what is being done.

    What the simulation says of springs' offsets is passed over: each run has its own zeros.
    Errors: ZygosError where the model does not fit the arm; Undecided where the runs do not tell its parameters apart.
    """
    simulation = replace(simulation, effects=tuple(e for e in simulation.effects if e.kind.key != OFFSET))
    # the matrices are narrow: threads only get in each other's way
    with threadpool_limits(limits=1):
        return _Explainer(arm, simulation, tuple(measured), validate, step).explain()


class _Explainer:
    def __init__(
        self,
        arm: Arm,
        simulation: Model,
        measured: tuple[MeasuredRun, ...],
        validate: MeasuredRun | None,
        step: Callable[[float, str], None],
    ) -> None:
        self.arm, self.simulation, self.measured, self.validate, self.step = arm, simulation, measured, validate, step
        self.remarks: list[str] = []

    def explain(self) -> Explanation:
        arm = self.arm
        layout = Layout(arm)
        self.step(0.05, "the simulation's own equations")
        if arm.torque_law == "sampled":
            self.remarks.append(
                'torques are taken as constant at their mean over a SYNC period: with torque_law = "sampled" twins '
                "err by the square of period_s"
            )
        for record in (*self.measured, *([] if self.validate is None else [self.validate])):
            if record.share < _USED:
                self.remarks.append(
                    f"{record.path.name}: {100 * record.share:.0f} % of the run lies in unbroken stretches and is used"
                )
        delivered = PlanarDynamics.from_model(arm, self.simulation)
        hypothesis = read_hypothesis(layout, self.simulation)
        refit = begin(self.measured, hypothesis, delivered)
        deflections = tuple(deflection(arm, self.measured, i) for i, rigid in enumerate(hypothesis.rigid) if rigid)
        flexible = [d for d in deflections if d.rms_rad > _DEFLECTED * d.noise_rad]
        skewed = [d for d in flexible if d.skew_share > _SKEWED]
        findings: list[Finding] = []
        found: Search | None = None
        basis = refit
        if flexible and not skewed:
            self.step(0.25, "the joints' flexibility")
            basis = self._flexible(refit, [d.joint for d in flexible])
            findings += [self._flexibility(basis, d) for d in flexible]
        if not skewed:
            self.step(0.4, "candidates")
            found = search(basis, lambda what: self.step(0.5, what))
            findings += [self._finding(found, k) for k in range(len(found.named))]
        self.step(0.65, "predictions of the untouched run")
        after = basis if found is None else found.after
        gap = self._gap(delivered, refit, after, found)
        if gap is not None and gap.closed.median > 1.1 * gap.delivered.median:
            self.remarks.append(
                "the drawing's values predict better than the fitted ones: these runs do not determine all values well"
            )
        self.step(0.9, "verdict")
        values = self._values(after)
        answer, sentence, partly = self._sensors_first(after, findings, skewed) or self._judge(
            found, findings, values, gap
        )
        local = refit.local()
        experiments: tuple[Experiment, ...] = ()
        if answer == "cannot tell" and found is not None:
            pair = next(names for names in found.sets if len(names) > 1)
            experiments = propose(found.after, pair[0], pair[1])
        kept = tuple(findings) if answer in {"named", "cannot tell"} else ()
        adopted = answer in {"named", "values differ", "nothing missing"}
        if adopted:
            self._remark_rest(after, kept, gap)
        return Explanation(
            arm,
            self.simulation,
            answer,
            sentence,
            whereabouts(arm, layout, local, flexible, kept, first=answer == "unknown" and " first: " in sentence),
            refit,
            found,
            kept,
            partly,
            values,
            deflections,
            experiments,
            gap,
            local,
            self._adopt(after, values, kept) if adopted else None,
            tuple(self.remarks),
        )

    def _flexible(self, refit: Study, joints: list[str]) -> Study:
        """The study with springs in these joints. The twin needs a first guess: each motor balance by itself has one.

        Errors: Undecided where it finds a spring that no joint has.
        """
        names = [joint.name for joint in self.arm.joints]
        freed = [names.index(joint) for joint in joints]
        rigid = tuple(was and i not in freed for i, was in enumerate(refit.hypothesis.rigid))
        free = replace(refit.hypothesis, rigid=rigid)
        dynamics = refit.model
        inertia, stiffness, damping = (x.copy() for x in (dynamics.rotor_inertia, dynamics.stiffness, dynamics.damping))
        for i in freed:
            balance = refit.layout.balances.index(f"M{i + 1}")
            own = fit(free, refit.sums, np.ones(len(refit.layout.balances)), alone=balance)
            inertia[i], stiffness[i], damping[i] = (float(own.of(f"{key}{i + 1}")) for key in ("Im", "k", "b"))
            damping[i] = max(damping[i], 0.0)
            if not (inertia[i] > 0.0 and stiffness[i] > 0.0):
                raise Undecided(
                    f"link and motor part at the {names[i]}, but not like a spring (k = {stiffness[i]:.4g} Nm/rad, "
                    f"Im = {inertia[i]:.4g} kg m^2); remedy: check its signs, zeros and gear ratio in the arm file"
                )
        guess = replace(dynamics, rotor_inertia=inertia, stiffness=stiffness, damping=damping)
        return begin(self.measured, free, guess)

    def _flexibility(self, study: Study, bent: Deflection) -> Finding:
        i = [joint.name for joint in self.arm.joints].index(bent.joint)
        k, sigma = self._size(study, f"k{i + 1}")
        return Finding(
            "joint_flexibility",
            "joint flexibility",
            bent.joint,
            k,
            sigma,
            "Nm/rad",
            f"link and motor part by {bent.rms_rad:.3g} rad rms, {_times(bent.rms_rad / bent.noise_rad)} their noise",
        )

    def _finding(self, found: Search, index: int) -> Finding:
        named, study = found.named[index], found.after
        value, sigma = self._size(study, named.name)
        if named.kind.key == "rotor_coupling":
            inertia = float(study.value[study.hypothesis.names.index(f"Im{named.joint + 1}")])
            value, sigma = value / inertia, sigma / inertia
        evidence = (
            f"{min(abs(z) for z in named.z):.0f} standard deviations of the null twin on either run, "
            f"{100 * min(found.completeness):.1f} % of the excess explained by all that is named"
        )
        joint = None if named.joint < 0 else self.arm.joints[named.joint].name
        assumed = study.hypothesis.momentum if named.kind.key == "angular_momentum" else None
        return Finding(
            named.kind.key,
            f"the right {named.kind.title} (it assumes {assumed:g} Nms)" if assumed else named.kind.title,
            joint,
            value,
            sigma,
            named.kind.unit,
            evidence,
            tuple(found.sets[index][1:]),
        )

    def _size(self, study: Study, name: str) -> tuple[float, float]:
        """A coefficient and its standard deviation: noise, or what the runs disagree by, whichever is more."""
        index = study.hypothesis.names.index(name)
        return float(study.value[index]), float(self._sigmas(study)[index])

    def _sigmas(self, study: Study) -> Array:
        each = np.array([study.of(study.hypothesis, [k]).value for k in range(len(study.records))])
        apart = each.std(axis=0, ddof=1) / np.sqrt(len(each))
        return np.asarray(np.maximum(study.spread, apart), dtype=np.float64)

    def _values(self, study: Study) -> tuple[Value, ...]:
        sigma = dict(zip(study.hypothesis.names, self._sigmas(study).tolist(), strict=True))
        base, effects = split(study.hypothesis, study.value)
        delivered = self.simulation.base_parameters(self.arm)
        values = [
            Value(name, q.unit, q.value, q.sigma, float(x), sigma.get(name, 0.0))
            for (name, q), x in zip(delivered.items(), base, strict=True)
        ]
        found = {effect.column(self.arm): effect.value for effect in effects}
        for effect in self.simulation.effects:
            name = effect.column(self.arm)
            if name in sigma:
                values.append(Value(name, effect.kind.unit, effect.value, effect.sigma, found[name], sigma[name]))
        return tuple(values)

    def _calibrated(self, record: MeasuredRun, study: Study) -> MeasuredRun:
        """A record less what its sensors' zeros are found to be off by, where that is more than is known of them."""
        layout = study.layout
        zeros = study.fit.zeros.mean(axis=0)
        off = np.where(np.abs(zeros) > _DEFLECTED * layout.zero_sigma, zeros, 0.0)
        if not off.any():
            return record
        listed = ", ".join(
            f"{name.replace('_zero', ' encoder of joint ').replace('_', ' ')} {1e3 * x:+.2g} mrad"
            + ("/s" if name == "gyro_bias" else "")
            for name, x in zip(layout.zeros, off, strict=True)
            if x
        )
        self.remarks.append(f"zeros of the sensors are off: {listed}; predictions are made with that taken off")
        q, theta = record.samples.q - off[:-1:2], record.samples.theta - off[1::2]
        return replace(record, samples=replace(record.samples, q=q, theta=theta), omega0=record.omega0 - off[-1])

    def _gap(self, delivered: PlanarDynamics, refit: Study, after: Study, found: Search | None) -> Gap | None:
        if self.validate is None:
            self.remarks.append("no run was kept apart (--validate): the gap is not known")
            return None
        segments = cut(self._calibrated(self.validate, after))
        closed = after.dynamics()
        before = closed if after is refit else refit.dynamics()
        if not after.physical:
            self.remarks.append(
                "no arm has the values that fit these runs; predictions are made with the nearest that has"
            )
        self.step(0.7, "predictions of the untouched run")
        last = forecast(closed, segments)
        wrong, wrong_name = None, ""
        other = None if found is None or not found.named else _other(found)
        if found is not None and other is not None:
            rest = after.hypothesis.effects[: -len(found.named)]
            instead = replace(after.hypothesis, effects=(*rest, other.name))
            try:
                study = again(found.before, instead, 2)
                wrong, wrong_name = forecast(study.dynamics(), segments), other.name
            except ZygosError:
                self.remarks.append(f"{other.name}, the best other candidate, has no size that an arm could have")
        self.step(0.85, "the floor")
        try:
            floor = forecast(closed, cut_twin(follow(closed, [self.validate])[0]))
        except Undecided as error:
            self.remarks.append(f"the untouched run has no twin, so the gap has no floor: {error}")
            return None
        return Gap(
            segments,
            forecast(delivered, segments),
            last if before is closed else forecast(before, segments),
            last,
            floor,
            self._struck(found, segments),
            wrong,
            wrong_name,
        )

    def _struck(self, found: Search | None, segments: Stretches) -> Forecast | None:
        """Predictions without what was named: an effect that is not there does not help them."""
        if found is None or not found.named:
            return None
        names = found.after.hypothesis.names
        value = found.after.value.copy()
        value[[names.index(candidate.name) for candidate in found.named]] = 0.0
        return forecast(realise(found.after.hypothesis, value), segments) if found.after.physical else None

    def _sensors_first(
        self, after: Study, findings: list[Finding], skewed: list[Deflection]
    ) -> tuple[Answer, str, str] | None:
        """What has to be put right in the arm file before anything can be said; None where it is right."""
        h = self.arm.period_s
        if skewed:
            worst = max(skewed, key=lambda d: d.rms_rad)
            sentence = (
                f"Timing first: what parts link and motor at the {worst.joint} goes with its rate, as if one encoder "
                f"latched {abs(worst.skew_s) * 1e3:.3g} ms after the other; no effect is named until latch_us is right."
            )
            return "unknown", sentence, ""
        lags = [finding.value / h for finding in findings if finding.kind == "torque_lag"]
        shifted = len(lags) == self.arm.n and any(
            max(abs(lag / part - 1.0) for lag in lags) < 0.05 for part in (0.5, 1)
        )
        if shifted or any(lag > 0.95 for lag in lags):
            sentence = (
                f"Timing first: the torques act {np.mean(lags):.2f} SYNC periods later than torque_law of the arm file "
                "says; no effect is named until it is right."
            )
            return "unknown", sentence, ""
        # a refit that fits better than noise allows has had noise taken out of its sums that was never there
        least = float(np.nanmin(after.excess))
        if np.nanmin((after.excess**2 - 1.0) / np.maximum(EXCESS, CERTAIN * after.wobble)) < -1.0:
            sentence = (
                f"Sensors first: the balances leave only {least:.2f} times what they would with the declared noise; no "
                "value is right until quanta, rate_sigma and torque_sigma of the arm file are."
            )
            return "unknown", sentence, ""
        return None

    def _judge(
        self, found: Search | None, findings: list[Finding], values: tuple[Value, ...], gap: Gap | None
    ) -> tuple[Answer, str, str]:
        assert found is not None
        share = min(found.completeness)
        rest = float(np.nanmax(found.after.excess))
        if not found.named and not excess(found.before):
            if not findings:
                return self._same_equations(found.after, values)
        elif not found.named or share < COMPLETE:
            partly = _listed(findings) if found.named and share >= PARTLY else ""
            sentence = (
                f"Something is missing that the catalogue does not hold: {rest:.3g} times the residual of the null "
            )
            sentence += f"twin is left over{_share(found)}."
            return "unknown", sentence, partly
        if gap is not None and gap.struck is not None and gap.closed.median > gap.struck.median:
            sentence = (
                f"{_listed(findings)} would explain the balances, but the untouched run is predicted better without "
                f"(median {gap.closed.median:.3g} sigma with, {gap.struck.median:.3g} without): not adopted."
            )
            return "unknown", sentence, _listed(findings)
        if any(finding.instead for finding in findings):
            sets = "; ".join(" or ".join((_said(f), *(spoken(self.arm, n) for n in f.instead))) for f in findings)
            return "cannot tell", f"These runs cannot tell apart: {sets}.", ""
        return "named", f"The simulation lacks {_listed(findings)}.", ""

    def _same_equations(self, study: Study, values: tuple[Value, ...]) -> tuple[Answer, str, str]:
        apart = self._apart(study)
        if apart:
            sentence = f"The arm is not the same in the two runs: they disagree on {apart}, and each closes by itself."
            return "unknown", sentence, ""
        changed = [value for value in values if value.differs]
        if not changed:
            return "nothing missing", "Nothing is missing above the detection limits, and no value differs.", ""
        gone = [spoken(self.arm, v.name) for v in changed if v.absent]
        listed = ", ".join(
            f"{v.name} {sized(v.found, v.sigma, v.unit)} (simulation {v.delivered:.5g}: {100 * v.change:+.3g} %)"
            for v in changed
            if not v.absent
        )
        parts = [f"The simulation has {' and '.join(gone)}, which these runs do not show."] if gone else []
        parts += [f"The equations are right, values differ: {listed}."] if listed else []
        return "values differ", " ".join(parts), ""

    def _remark_rest(self, study: Study, findings: tuple[Finding, ...], gap: Gap | None) -> None:
        """Say what an answer leaves over."""
        rho = float(np.nanmax(study.excess))
        if findings and excess(study):
            self.remarks.append(
                f"a balance still leaves {rho:.2g} times what its twin does: the law is not exactly this, or something "
                "smaller is missing beside it"
            )
        if gap is not None and gap.closed.median > 3.0 * gap.floor.median:
            self.remarks.append(
                f"predictions err by {gap.closed.median / gap.floor.median:.2g} times the floor: the values are not "
                "known as well as these sensors would show, or the arm is another in the untouched run"
            )
        apart = self._apart(study)
        if findings and apart:
            self.remarks.append(f"the two runs disagree on {apart}")

    def _apart(self, study: Study) -> str:
        """Parameters on which the runs disagree by more than their twins' noise and by more than a trifle, in words."""
        hypothesis = study.hypothesis
        each = [study.of(hypothesis, [k]).value for k in range(len(study.records))]
        drawn = [study.of_twin(hypothesis, [k]).value for k in range(len(study.records))]
        spread = np.sqrt(sum(values.var(axis=0, ddof=1) for values in drawn))
        shift = drawn[0].mean(axis=0) - drawn[1].mean(axis=0)
        out = []
        for k, name in enumerate(hypothesis.names):
            difference = abs(float(each[0][k] - each[1][k] - shift[k]))
            if name in self.arm.parameter_names and difference > max(
                DISAGREE * float(spread[k]), MATERIAL * abs(float(study.value[k]))
            ):
                out.append(f"{name} ({each[0][k]:.5g} on the first, {each[1][k]:.5g} on the second)")
        return ", ".join(out)

    def _adopt(self, study: Study, values: tuple[Value, ...], findings: tuple[Finding, ...]) -> Model:
        """The model with the values and effects that were learned; what it said of other effects is kept."""
        parameters = {
            v.name: Quantity(v.found, v.sigma if np.isfinite(v.found) else 0.0, "zygos", v.unit)
            for v in values
            if v.name in self.arm.parameter_names
        }
        _, effects = split(study.hypothesis, study.value)
        new = {(f.kind, f.joint): f for f in findings}
        kept: list[Effect] = []
        for effect in effects:
            finding = new.get((effect.kind.key, effect.joint))
            if finding is not None:
                low, high = finding.interval
                evidence = f"95 % interval {low:.4g} .. {high:.4g} {finding.unit}; {finding.evidence}"
                # a rotor that couples at all does so with its whole inertia
                value = 1.0 if effect.kind.key == "rotor_coupling" else finding.value
                kept.append(Effect(effect.kind, effect.joint, value, finding.sigma, "zygos", evidence))
            elif effect.source == "zygos":
                value, sigma = self._size(study, effect.column(self.arm))
                # an effect of the simulation that the runs do not show leaves the model
                if value > DIFFERS * sigma or (value < -DIFFERS * sigma and not effect.kind.positive):
                    kept.append(replace(effect, value=value, sigma=sigma))
            else:
                kept.append(effect)
        return Model(f"{self.simulation.name}, explained", parameters=parameters, effects=tuple(kept))


def deflection(arm: Arm, records: Sequence[MeasuredRun], joint: int) -> Deflection:
    """How far link and motor part at a joint, and how much of it goes with the joint's rate."""
    h = arm.period_s
    parted, rate = [], []
    for record in records:
        readings = record.readings()
        apart = (readings.theta - readings.q)[..., joint]
        parted.append((apart - apart.mean())[:, 1:-1].ravel())
        rate.append(((readings.q[:, 2:, joint] - readings.q[:, :-2, joint]) / (2.0 * h)).ravel())
    d, v = np.concatenate(parted), np.concatenate(rate)
    v = v - v.mean()
    skew = float(d @ v / (v @ v)) if np.any(v) else 0.0
    described = arm.joints[joint]
    return Deflection(
        described.name,
        float(np.sqrt(np.mean(d**2))),
        float(np.hypot(described.link_encoder.sigma_rad, described.motor_encoder.sigma_rad)),
        skew,
        float(1.0 - np.mean((d - skew * v) ** 2) / np.mean(d**2)) if np.any(d) else 0.0,
    )


def whereabouts(
    arm: Arm,
    layout: Layout,
    local: Array,
    flexible: Sequence[Deflection],
    findings: Sequence[Finding] = (),
    *,
    first: bool = False,
) -> str:
    """One sentence on which balance fails, from each balance by itself, and on where to look.

    Where effects were named, it is their places; where timing or sensors come first, it is the verdict that says where.
    Else it is where those balances are that fail about as much as the worst: an effect shows in others, too.
    """
    worst = np.nanmax(np.where(np.isnan(local), 0.0, local), axis=0)
    said = dict(zip(layout.balances, worst.tolist(), strict=True))
    failing = [name for name, rho in said.items() if rho**2 - 1.0 > EXCESS]
    parts = [
        f"link and motor of the {bent.joint} part by {_times(bent.rms_rad / bent.noise_rad)} their noise"
        for bent in flexible
    ]
    for name in failing:
        what = {"E": "the energy balance", "H": "the momentum"}.get(name, "")
        what = what or f"the motor balance of the {arm.joints[int(name[1:]) - 1].name}"
        parts.append(f"{what} leaves {_times(said[name])} what its twin does")
    if not parts:
        return "Every balance closes as well as its twin's."
    tail = ""
    if findings:
        places = dict.fromkeys(_place(finding) for finding in findings)
        tail = f": what explains it acts {' and '.join(places)}"
    elif not first:
        tail = _look_at(arm, said, failing, bent=bool(flexible))
    said_all = "; ".join(parts) + tail + "."
    return said_all[0].upper() + said_all[1:]


def _look_at(arm: Arm, said: dict[str, float], failing: Sequence[str], *, bent: bool) -> str:
    most = max((said[name] for name in failing), default=0.0)
    plain = [name for name in failing if said[name] >= _ALIKE * most]
    motors = [arm.joints[int(name[1:]) - 1].name for name in plain if name[0] == "M"]
    base = "the base, the gyro, or the momentum that is assumed"
    if motors:
        return f": look at the motor side of the {' and the '.join(motors)}" + (f", and at {base}" * ("H" in plain))
    if bent:
        return ": look at the joints' flexibility first"
    if "H" in plain:
        # friction at a link shows in the momentum, too
        return f": look at {base}" + (", and at the link side" if "E" in failing else "")
    if "H" in failing:
        return f": look at the link side, then at {base}"
    return " while every motor balance closes: look at the link side" if failing == ["E"] else ": look at the link side"


def _place(finding: Finding) -> str:
    """Where a finding acts, in words."""
    if finding.joint is None:
        return "on the base"
    side = {"motor": "at the motor side", "torque": "at the motor side", "link": "at the link side"}
    kind = CATALOGUE.get(finding.kind)
    return f"{side.get(kind.place if kind else '', 'at the joint')} of the {finding.joint}"


def _other(found: Search) -> Candidate | None:
    """The best candidate that was not named, nor cannot be told from one that was."""
    taken = {name for names in found.sets for name in names}
    return next((c for c in found.rounds[0] if c.name not in taken and (c.value > 0.0 or not c.kind.positive)), None)


def _times(ratio: float) -> str:
    return f"{ratio:,.0f} times" if ratio >= 10.0 else f"{ratio:.1f} times"


def _said(finding: Finding) -> str:
    at = "of the arm" if finding.joint is None else f"({finding.joint})"
    return f"{finding.title} {at}"


def _listed(findings: Sequence[Finding]) -> str:
    return " and ".join(f"{_said(f)}, {sized(f.value, f.sigma, f.unit)}" for f in findings)


def sized(value: float, sigma: float, unit: str) -> str:
    """A value and its 95 % interval to two digits of the latter, in words."""
    half = INTERVAL * sigma
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 9)) if 0.0 < half < np.inf else 4
    return f"{value:,.{digits}f} ± {half:.{digits}f}" + ("" if unit == "1" else f" {unit}")


def _share(found: Search) -> str:
    if not found.named:
        return ""
    listed = ", ".join(spoken(found.after.layout.arm, candidate.name) for candidate in found.named)
    return f"; the best guess ({listed}) takes {100 * min(found.completeness):.0f} % of the excess away"
