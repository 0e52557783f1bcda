# SPDX-License-Identifier: MIT
"""From two runs and a simulation to a verdict: what is missing, where, how much, and what the gap is with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from zygos import limits
from zygos.arm import Arm
from zygos.dynamics.equations import from_model, from_parameters, parameters
from zygos.dynamics.joints import Drives
from zygos.effects import CATALOGUE, OFFSET, Effect
from zygos.errors import Undecided, ZygosError
from zygos.gap.adopted import Adopted, Check, NotAdopted, no_worse
from zygos.gap.balances import Acting, Layout, acting, corrected
from zygos.gap.changes import BODIES, Change, find_change, settled
from zygos.gap.experiment import Experiment, propose
from zygos.gap.explanation import Explanation
from zygos.gap.findings import FLEXIBILITY, Deflection, Disagreement, Finding, Gap, Significance, Value
from zygos.gap.fit import Hypothesis, fit
from zygos.gap.forecast import Forecast, Stretches, cut, cut_twin, forecast
from zygos.gap.form import form_sigma
from zygos.gap.payload import PayloadValue, payload_of
from zygos.gap.record import MeasuredRun
from zygos.gap.remainder import allowed_by, closes, closes_by_noise, far_off, remainders, unclosed
from zygos.gap.search import (
    Candidate,
    Search,
    allowed,
    excess,
    judged_beside,
    limits_beyond,
    polished,
    possible,
    refined,
    rivals,
    search,
    struck,
    unsteady,
    widened,
    with_rivals,
)
from zygos.gap.sentences import entry_evidence
from zygos.gap.study import (
    Study,
    begin,
    own_errors,
    read_hypothesis,
    realise,
    sensor_effects,
    split,
)
from zygos.gap.torques import with_hidden_noise, with_torque_noise
from zygos.gap.twin import follow
from zygos.gap.verdicts import (
    AboveFloor,
    ArmFileFirst,
    BrokenRun,
    Changed,
    DeclaredTooNoisy,
    Disagreements,
    DrawingPredictsBetter,
    GainOff,
    Impossible,
    Inseparable,
    Lacking,
    LateTorques,
    NearestArm,
    NoFloor,
    NotAdmissible,
    NothingMissing,
    NotPredicted,
    NoUntouchedRun,
    PartNamed,
    PlainEstimate,
    Remark,
    RunsDisagree,
    SkewedEncoders,
    StillLeft,
    TorquesMisread,
    TorquesSampled,
    Unexplained,
    ValuesDiffer,
    Verdict,
    ZerosOff,
)
from zygos.gap.whereabouts import deflection, whereabouts
from zygos.model.model import Model, Quantity
from zygos.quantiles import student_factor

Array = NDArray[np.float64]


def explain(
    arm: Arm,
    simulation: Model,
    measured: Sequence[MeasuredRun],
    validate: Sequence[MeasuredRun],
    step: Callable[[float, str], None] = lambda share, what: None,
    without: Sequence[str] = (),
    plain: Model | None = None,
) -> Explanation:
    """Say what a simulation lacks. measured: two runs at least. validate: runs that are kept apart. step is told the
    share done and what is being done. without: keys of effects that are not tried. plain: the estimate of
    `zygos estimate` from the measured runs, if there is one.

    What the simulation says of springs' offsets is passed over: each run has its own zeros.
    Errors: ZygosError where the model does not fit the arm; Undecided where the runs do not tell its parameters apart.
    """
    simulation = replace(simulation, effects=tuple(e for e in simulation.effects if e.kind.key != OFFSET))
    # the matrices are narrow: threads only get in each other's way
    with threadpool_limits(limits=1):
        return _Explainer(simulation, tuple(measured), tuple(validate), step, tuple(without), plain).explain()


class _Told(NamedTuple):
    """A search, and what follows from it."""

    found: Search | None
    gap: Gap | None
    findings: tuple[Finding, ...]
    values: tuple[Value, ...]
    verdict: Verdict


_Closer = tuple[Search, Gap]
"""A search, and the gap with it."""


class _Explainer:
    def __init__(
        self,
        simulation: Model,
        measured: tuple[MeasuredRun, ...],
        validate: tuple[MeasuredRun, ...],
        step: Callable[[float, str], None],
        without: tuple[str, ...],
        plain: Model | None = None,
    ) -> None:
        self.without, self.plain = without, plain
        self.simulation, self.measured, self.validate, self.step = simulation, measured, validate, step
        self.declared = self.known = measured[0].arm
        """As its file says; and with the noise of the torques of which there is more evidence than that it would
        explain what is left over."""
        self.most = self.declared
        """With the most noise of the torques that the runs do not rule out."""
        self.remarks: list[Remark] = []
        self.gains: tuple[str, ...] = ()
        """Columns of the gains of torque sensors that are effects, because no sensor errs by so much."""

    @property
    def arm(self) -> Arm:
        """With the noise that its torques are taken to have."""
        return self.measured[0].arm

    def explain(self) -> Explanation:
        self.step(0.05, "the simulation's own equations")
        self._remark_runs()
        refit = self._refit()
        arm, layout, hypothesis = self.arm, Layout(self.arm), refit.hypothesis
        delivered = from_model(arm, self.simulation)
        deflections = tuple(deflection(arm, self.measured, i) for i, rigid in enumerate(hypothesis.rigid) if rigid)
        flexible = [d for d in deflections if d.rms_rad > limits.DEFLECTED_Z.value * d.noise_rad]
        skewed = [d for d in flexible if d.skew_share > limits.SKEWED.value]
        parted: tuple[Finding, ...] = ()
        found: Search | None = None
        basis = refit
        if flexible and not skewed:
            self.step(0.25, "the joints' flexibility")
            basis = self._flexible(refit, [d.joint for d in flexible])
            parted = tuple(self._flexibility(basis, d) for d in flexible)
        gap: Gap | None = None
        changed: Changed | None = None
        if not skewed:
            found, gap, changed = self._searched(delivered, refit, basis)
            if basis is refit and changed is None and (not found.named or _common_offset(found.after)):
                better = self._with_less_noise(delivered, found)
                if better is not None:
                    refit, found, gap = better
                    basis, arm, layout = refit, self.arm, Layout(self.arm)
            if changed is None and found.named:
                closer = self._with_constant_errors(delivered, _own(refit, basis, found), found, gap)
                if closer is not None:
                    found, gap = closer
                    arm, layout = self.arm, Layout(self.arm)
        if found is not None and _own(refit, basis, found) is not refit:
            basis = refit = found.before
        if skewed:
            gap = self._gap(delivered, refit, basis, found)

        def told(search: Search | None, gap: Gap | None) -> _Told:
            return self._told(refit, basis, search, gap, changed, parted, skewed)

        first = told(found, gap)
        answer = self._with_fewer_names(first, lambda less: told(less, self._gap(delivered, refit, less.after, less)))
        found, gap, _, values, verdict = answer
        after = basis if found is None else found.after
        if gap is not None and gap.closed.median > limits.NOT_WORSE.value * gap.delivered.median:
            self.remarks.append(DrawingPredictsBetter())
        self.step(0.9, "verdict")
        local = refit.local()
        experiments = self._experiments(found, verdict)
        kept = verdict.findings if isinstance(verdict, Lacking | PartNamed | Inseparable) else ()
        adopted: Adopted | None = None
        if isinstance(verdict, Lacking | PartNamed | Changed | ValuesDiffer | NothingMissing):
            self._remark_rest(after, kept, gap)
            adopted, verdict, gap = self._through_the_gate(after, values, kept, verdict, gap)
            if isinstance(verdict, PlainEstimate | NotAdmissible):
                kept = ()
        return Explanation(
            arm,
            self.simulation,
            verdict,
            whereabouts(arm, layout, local, flexible, kept, first=isinstance(verdict, ArmFileFirst)),
            refit,
            found,
            kept,
            values,
            deflections,
            experiments,
            gap,
            local,
            adopted,
            tuple(self.remarks),
            self.validate,
        )

    def _experiments(self, found: Search | None, verdict: Verdict) -> tuple[Experiment, ...]:
        """Motions that would tell a set apart, best first."""
        if not isinstance(verdict, Inseparable) or found is None:
            return ()
        # a shape that was refined is no longer among the columns of its set
        known = {one.name for one in found.after.layout.effects}
        pair = next((names for names in found.sets if len(names) > 1 and known.issuperset(names[:2])), None)
        return () if pair is None else propose(found.after, pair[0], pair[1])

    def _told(
        self,
        refit: Study,
        basis: Study,
        found: Search | None,
        gap: Gap | None,
        changed: Changed | None,
        parted: tuple[Finding, ...],
        skewed: Sequence[Deflection],
    ) -> _Told:
        """What follows from a search, which there is unless encoders are skewed. parted: joints that are not rigid."""
        findings, after = list(parted), basis
        if found is not None:
            after = found.after
            if changed is None:
                findings += [self._gain(found, name) for name in self.gains]
            findings += [self._finding(found, k) for k in range(len(found.named))]
        values = self._values(after)
        verdict = (
            changed
            or self._sensors_first(refit, after, findings, skewed)
            or self._judge(found, tuple(findings), values, gap)
        )
        return _Told(found, gap, tuple(findings), values, verdict)

    def _with_fewer_names(self, told: _Told, judged: Callable[[Search], _Told]) -> _Told:
        """The answer without names of which not even the sign is certain, the least certain one left out first, where
        that of another is certain and the others are an answer. judged: what follows from a search with fewer names."""
        now, remarks = told, list(self.remarks)
        while isinstance(now.verdict, Unexplained) and now.found is not None and len(now.found.named) > 1:
            found, own = now.found, now.findings[-len(now.found.named) :]
            unsigned = [k for k, finding in enumerate(own) if finding in now.verdict.unsigned]
            # where no name is certain, they make up for each other, and one of them would be as wrong
            if not unsigned or len(unsigned) == len(own):
                break
            least = max(unsigned, key=lambda k: own[k].sigma / max(abs(own[k].value), 1e-300))
            try:
                now = judged(struck(found, found.named[least]))
            except Undecided:
                break
        if isinstance(now.verdict, Lacking | PartNamed):
            return now
        self.remarks = remarks
        return told

    def _refit(self) -> Study:
        """The simulation's own equations, fitted. What the arm file does not say of its torques' noise, the runs do."""
        declared = self.declared
        likely, most = with_torque_noise(declared, self.measured)
        self.most = most
        self._take(likely)
        refit = self._own_equations()
        if likely != declared and _torques_too_quiet(refit).any():
            # noise that only seems to be there
            self._take(declared)
            plain = self._own_equations()
            if not _torques_too_quiet(plain).any():
                likely, refit = declared, plain
            self._take(likely)
        self.known = likely
        if likely == most or not excess(refit) or np.nanmax(refit.excess) > limits.NOISY.value:
            return refit
        # noise that the runs do not rule out comes before anything that is missing
        self._take(most)
        noisier = self._own_equations()
        # a balance that would be too quiet rules such noise out
        if not excess(noisier) and not (_torques_too_quiet(noisier) & ~_torques_too_quiet(refit)).any():
            return noisier
        self._take(likely)
        return refit

    def _with_less_noise(self, delivered: Drives, found: Search) -> tuple[Study, Search, Gap | None] | None:
        """The refit, search and gap with less noise of the torques than was assumed, where effects explain nearly
        everything then: real noise is nothing that they could explain. None where they do not.

        A small effect may be taken for noise, and so may the chatter of a friction near rest, which hides it. Torques
        with noise have an offset in each run, which hides one that is the same in all of them.
        """
        taken, remarks, gains = self.arm, list(self.remarks), self.gains
        less = self.known if taken != self.known else self.declared if found.named or excess(found.after) else taken
        if less == taken:
            return None
        self._take(less)
        refit = self._own_equations()
        instead, gap, changed = self._searched(delivered, refit, refit)
        # an offset, which noisy torque sensors have in any case, is nothing that is missing
        columns = [instead.after.layout.find(one.name) for one in instead.named]
        more = [one for one in columns if not (one.kind.key == "torque_offset" and found.after.layout.covers(one))]
        closed = not found.named or not excess(instead.after)
        if changed is None and more and closed and min(instead.completeness) >= limits.COMPLETE.value:
            return refit, instead, gap
        self._take(taken)
        self.remarks, self.gains = remarks, gains
        return None

    def _with_constant_errors(self, delivered: Drives, refit: Study, found: Search, gap: Gap | None) -> _Closer | None:
        """The search and the gap where torque sensors whose noise the runs do not rule out have an offset and a gain of
        their own in each run, if the same names are given beside these errors and the untouched runs close. None
        otherwise.

        Coarse encoders hide the noise of a torque in the balances, but not what its offset and its gain do to
        predictions. The floor stays that of torques without noise.
        """
        taken, named = self.arm, found.named
        hidden = [
            own.torque_sigma == 0.0 < most.torque_sigma
            for own, most in zip(taken.joints, self.most.joints, strict=True)
        ]
        if gap is None or closes(gap) or not any(hidden) or self.gains:
            return None
        self.step(0.85, "offsets and gains of the torque sensors")
        quiet, remarks = with_hidden_noise(taken), list(self.remarks)
        layout = replace(found.after.layout, arm=quiet)
        if not all(one.name in {other.name for other in layout.effects if not layout.covers(other)} for one in named):
            return None
        self._take(quiet)
        with suppress(Undecided, ZygosError):
            wanted = replace(found.after.hypothesis, layout=layout)
            beside = judged_beside(found, begin(self.measured, wanted, found.after.dynamics()))
            if beside is not None:
                told = self._gap(delivered, refit, beside.after, beside)
                if told is not None and closes(told):
                    self._remark(self._misread(beside.after))
                    return beside, told
        self._take(taken)
        self.remarks = remarks
        return None

    def _misread(self, study: Study) -> TorquesMisread:
        """The constant errors of the torque sensors, as means over the measured runs."""
        mean = dict(zip(study.layout.zeros, study.zeros.mean(axis=0).tolist(), strict=True))
        each = [
            (joint.name, mean.get(f"torque_zero{k}", 0.0), mean.get(f"torque_scale{k}", 0.0))
            for k, joint in enumerate(self.arm.joints, 1)
        ]
        return TorquesMisread(tuple(each))

    def _own_equations(self) -> Study:
        hypothesis = replace(read_hypothesis(Layout(self.arm), self.simulation), without=self.without)
        return begin(self.measured, hypothesis, from_model(self.arm, self.simulation))

    def _take(self, arm: Arm) -> None:
        """Read the runs as those of this arm."""
        self.measured, self.validate = (
            tuple(replace(one, arm=arm) for one in records) for records in (self.measured, self.validate)
        )

    def _remark_runs(self) -> None:
        """Note what the runs have against them."""
        if self.arm.torque_law == "sampled":
            self._remark(TorquesSampled())
        used: dict[str, float] = {}
        for record in (*self.measured, *self.validate):
            used[record.path.name] = used.get(record.path.name, 0.0) + record.share
        self.remarks += [BrokenRun(name, share) for name, share in used.items() if share < limits.USED.value]

    def _searched(self, delivered: Drives, refit: Study, basis: Study) -> tuple[Search, Gap | None, Changed | None]:
        """Usual entries, then every entry, then changes with time, as long as something is left over."""
        self.step(0.3, "candidates")
        found = search(basis, lambda what: self.step(0.35, what))
        gained = self._gained(basis, found.after)
        if gained is not basis:
            basis, found = gained, search(gained, lambda what: self.step(0.45, what))

        def gap_with(found: Search) -> Gap | None:
            return self._gap(delivered, _own(refit, basis, found), found.after, found)

        every: Study | None = None
        plain = found
        if found.named:
            self.step(0.5, "every entry of the catalogue beside what was named, and in its place")
            with suppress(Undecided):
                beside = widened(found.after)
                found = refined(found, beside)
                if found is plain and not self._open(found):
                    found = self._challenged(basis, found, beside)
        if self._open(found):
            every, wider = self._wider(basis)
            if wider is not None and _explains_more(wider, found):
                found = wider
        elif not found.named:
            self.step(0.5, "detection limits of the other entries")
            with suppress(Undecided):
                found = replace(found, beyond=limits_beyond(found.after, widened(found.after)))
        if self._unsettled(found) and not _torques_too_quiet(basis).any():
            self.step(0.65, "changes with time")
            # what begins may be a usual entry, or any
            for study in (basis, *(() if every is None else (every,))):
                changed, later, earlier = self._changed(found, study, basis.layout)
                if changed is not None:
                    told = self._gap(delivered, _own(refit, basis, found), later.after, later, limits.SYSTEMATIC.value)
                    if _closes_before(earlier) if told is None else _predicts(told) or _closes_with(earlier, told):
                        return later, told, changed
        gap = gap_with(found)
        if every is None and gap is not None and gap.struck is not None and _worse(gap, gap.struck):
            # a share of a large excess says little: what the untouched run speaks against stood for something else
            _, wider = self._wider(basis)
            instead = None if wider is None or not wider.named else gap_with(wider)
            if wider is not None and instead is not None and closes(instead):
                return wider, instead, None
        return found, gap, None

    def _wider(self, basis: Study) -> tuple[Study | None, Search | None]:
        """The basis with every entry of the catalogue, and the search among them; None where the runs do not tell their
        columns apart."""
        self.step(0.5, "every entry of the catalogue")
        try:
            every = widened(basis)
        except Undecided:
            return None, None
        try:
            return every, polished(search(basis, lambda what: self.step(0.6, what), every))
        except Undecided:
            return every, None

    def _challenged(self, basis: Study, found: Search, every: Study) -> Search:
        """The search among usual entries, or with those others that may be what was named instead: a name is given
        against the whole catalogue. every: the closed study `widened`. Errors: Undecided where the runs do not tell its
        columns apart."""
        others = rivals(found, every)
        if not others:
            return found
        again = polished(search(with_rivals(basis, others), lambda what: self.step(0.6, what)))
        return (
            again if min(again.completeness) > min(found.completeness) - limits.TRIFLE.value and again.named else found
        )

    def _gained(self, basis: Study, after: Study) -> Study:
        """The basis with the gains of torque sensors that are far off after all that was named as effects, the same in
        all runs; what is less is an error of the sensor that each run has for itself, and a remark where it is more
        than expected."""
        found: dict[str, Acting] = {}
        if excess(after):
            # a gain takes up whatever is not explained
            return basis
        drawn = after.of_twin(after.hypothesis).zeros.std(axis=0, ddof=1)
        for k, name in enumerate(after.layout.zeros):
            if not after.layout.errors[name].gain:
                continue
            joint = int(name.removeprefix("torque_scale")) - 1
            each, sigma = after.zeros[:, k], drawn[:, k]
            share = float(np.mean(each))
            if np.any(np.abs(each) < limits.DISAGREE_Z.value * sigma) or abs(share) < limits.GAIN.value:
                continue
            gain = Acting(CATALOGUE["torque_gain"], joint)
            if abs(share) > limits.GAIN_OFF.value and "torque_gain" not in self.without:
                found[gain.name] = gain
            self._remark(GainOff(self.arm.joints[joint].name, self.arm.joints[0].name, share))
        if not found:
            return basis
        hypothesis, layout = basis.hypothesis, basis.layout
        wider = replace(layout, own=(*layout.own, *found.values()))
        self.gains = tuple(found)
        wanted = replace(hypothesis, layout=wider, effects=(*hypothesis.effects, *found))
        try:
            return begin(self.measured, wanted, basis.dynamics())
        except Undecided:
            self.gains = ()
            return basis

    def _gain(self, found: Search, name: str) -> Finding:
        study = found.after
        value, sigma = self._size(study, name)
        index = study.hypothesis.names.index(name)
        runs = range(len(study.records))
        z = [float(study.of(study.hypothesis, [k]).value[index]) / float(study.spread[index]) for k in runs]
        one = study.layout.find(name)
        proof = Significance(min(map(abs, z)), min(found.completeness))
        joint = self.arm.joints[one.joint].name
        return Finding(one.kind.key, joint, value, sigma, one.kind.unit, proof, entry=one.kind)

    def _flexible(self, refit: Study, joints: list[str]) -> Study:
        """The study with springs in these joints. The twin needs a first guess: each motor balance by itself has one.

        Errors: Undecided where it finds a spring that no joint has.
        """
        names = [joint.name for joint in self.arm.joints]
        freed = [names.index(joint) for joint in joints]
        rigid = tuple(was and i not in freed for i, was in enumerate(refit.hypothesis.rigid))
        free = replace(refit.hypothesis, rigid=rigid)
        values = parameters(self.arm, refit.model)
        at = self.arm.parameter_names
        for i in freed:
            balance = refit.layout.balances.index(f"M{i + 1}")
            own = fit(free, refit.sums, np.ones(len(refit.layout.balances)), alone=balance)
            inertia, stiffness, damping = (float(own.of(f"{key}{i + 1}")) for key in ("Im", "k", "b"))
            if not (inertia > 0.0 and stiffness > 0.0):
                raise Undecided(
                    f"link and motor part at the {names[i]}, but not like a spring (k = {stiffness:.4g} Nm/rad, "
                    f"Im = {inertia:.4g} kg m^2); remedy: check its signs, zeros and gear ratio in the arm file"
                )
            for key, value in (("Im", inertia), ("k", stiffness), ("b", max(damping, 0.0))):
                values[at.index(f"{key}{i + 1}")] = value
        effects = split(refit.hypothesis, refit.value)[1]
        guess = from_parameters(self.arm, values, effects)
        return begin(self.measured, free, guess)

    def _flexibility(self, study: Study, bent: Deflection) -> Finding:
        i = [joint.name for joint in self.arm.joints].index(bent.joint)
        k, sigma = self._size(study, f"k{i + 1}")
        return Finding(FLEXIBILITY, bent.joint, k, sigma, "Nm/rad", bent)

    def _finding(self, found: Search, index: int) -> Finding:
        named, study = found.named[index], found.after
        value, sigma = self._size(study, named.name)
        sigma = float(np.hypot(sigma, form_sigma(study, named.name)))
        if named.kind.key == "rotor_coupling":
            inertia = float(study.value[study.hypothesis.names.index(f"Im{named.joint + 1}")])
            value, sigma = value / inertia, sigma / inertia
        evidence = Significance(min(abs(z) for z in named.z), min(found.completeness))
        joint = None if named.joint < 0 else self.arm.joints[named.joint].name
        assumed = study.hypothesis.momentum if named.kind.key == "angular_momentum" else None
        instead = tuple(found.sets[index][1:])
        component = study.layout.find(named.name).component
        return Finding(
            named.kind.key,
            joint,
            value,
            sigma,
            named.kind.unit,
            evidence,
            instead,
            assumed,
            named.shape,
            component,
            named.kind,
        )

    def _size(self, study: Study, name: str) -> tuple[float, float]:
        """A coefficient, and the standard deviation of a normal variable with the same 95 % interval: noise, which a
        few readings of the twin tell, or what the runs disagree by, whichever is more."""
        index = study.hypothesis.names.index(name)
        sigma = max(float(self._sigmas(study)[index]), self._with_its_shape(study, name))
        freedom = len(study.twin_sums[0].gram[0]) - 1
        return float(study.value[index]), sigma * float(
            student_factor(limits.CONFIDENCE.value, freedom)
        ) / limits.INTERVAL_Z.value

    def _with_its_shape(self, study: Study, name: str) -> float:
        """Standard deviation of a coefficient whose law has a shape that is not known either: that of the sum of the
        coefficients at two shapes, because c f(s) + d f(s + e) is (c + d) f(s) + d e df/ds. 0 without a shape, or where
        it is a whole number."""
        if "@" not in name:
            return 0.0
        own = study.layout.find(name)
        if own.shape is None or not own.kind.shape_varies:
            return 0.0
        shape = own.shape
        others = [x for x in study.layout.effects if x.plain == own.plain and x.shape not in (None, shape)]
        if not others:
            return 0.0
        for near in sorted(others, key=lambda x: abs(np.log((x.shape or shape) / shape))):
            # a gap that is wider than the spring ever bends is a stiffness, which the runs do not tell from k
            with suppress(Undecided):
                return self._of_a_sum(study, name, near.name)
        return 0.0

    def _of_a_sum(self, study: Study, name: str, other: str) -> float:
        """Standard deviation of the sum of a coefficient and of another one that is fitted beside it.

        Errors: Undecided where the runs do not tell them apart."""
        wider = replace(study.hypothesis, effects=(*study.hypothesis.effects, other))
        at = [wider.names.index(one) for one in (name, other)]
        spread = float(study.of_twin(wider).value[:, at].sum(axis=1).std(ddof=1))
        return max(spread, float(_between_runs(study, wider, lambda value: value[at].sum())))

    def _sigmas(self, study: Study) -> Array:
        apart = _between_runs(study, study.hypothesis, lambda value: value)
        return np.asarray(np.maximum(study.spread, apart), dtype=np.float64)

    def _values(self, study: Study) -> tuple[Value, ...]:
        sigma = dict(zip(study.hypothesis.names, self._sigmas(study).tolist(), strict=True))
        base, effects = split(study.hypothesis, study.value)
        delivered = self.simulation.base_parameters(self.arm)
        values = [
            Value(name, q.unit, q.value, q.sigma, float(x), sigma.get(name, 0.0))
            for (name, q), x in zip(delivered.items(), base, strict=True)
        ]
        found = {acting(effect, self.arm).name: effect.value for effect in effects}
        for effect in self.simulation.effects:
            name = acting(effect, self.arm).name
            if name in sigma:
                values.append(Value(name, effect.kind.unit, effect.value, effect.sigma, found[name], sigma[name]))
        return tuple(values)

    def _calibrated(self, records: Sequence[MeasuredRun], study: Study) -> list[MeasuredRun]:
        """Records less what their sensors' zeros are found to be off by, where that is more than is known of them.

        The offset of a torque is another in each run, so that it is taken from the run itself.
        """
        layout = study.layout
        zeros = study.zeros.mean(axis=0)
        torque = layout.of_torque
        off = np.where((np.abs(zeros) > limits.DEFLECTED_Z.value * layout.declared_sigma) | torque, zeros, 0.0)
        if not off.any():
            return list(records)
        told = np.where(torque, 0.0, off)
        if told.any():
            off_ones = tuple((n, float(x)) for n, x in zip(layout.zeros, told, strict=True) if x)
            self._remark(ZerosOff(off_ones, all(name in layout.loose for name, _ in off_ones)))
        known = [corrected(record, layout, off) for record in records]
        offsets = np.array([name.startswith("torque_zero") for name in layout.zeros])
        if not offsets.any():
            return known
        return [corrected(one, layout, np.where(offsets, own_errors(study, one), 0.0)) for one in known]

    def _remark(self, one: Remark) -> None:
        """Note it, once."""
        if one not in self.remarks:
            self.remarks.append(one)

    def _gap(
        self, delivered: Drives, refit: Study, after: Study, found: Search | None, systematic: float = 0.0
    ) -> Gap | None:
        """Predictions of the untouched runs. systematic: share by which values may err beyond their scatter."""
        if not self.validate:
            self._remark(NoUntouchedRun())
            return None
        segments = Stretches.joined([cut(record) for record in self._calibrated(self.validate, after)])
        closed = after.dynamics()
        before = closed if after is refit else refit.dynamics()
        if not after.physical:
            self._remark(NearestArm())
        self.step(0.7, "predictions of the untouched run")
        errors = sensor_effects(after.hypothesis, after.value)
        last = forecast(closed, segments, errors)
        refitted = last if before is closed else forecast(before, segments)
        wrong, wrong_name = None, ""
        other = None if found is None or not found.named else _other(found)
        if found is not None and other is not None:
            plain = found.before.hypothesis
            instead = replace(plain, effects=(*plain.effects, other.name))
            try:
                wrong, wrong_name = forecast(found.before.dynamics_of(instead), segments, (), refitted), other.name
            except ZygosError:
                self._remark(Impossible(other.name))
        self.step(0.85, "the floor")
        try:
            twin = Stretches.joined([cut_twin(one) for one in follow(closed, self.validate, errors)])
        except Undecided as error:
            self._remark(NoFloor(str(error)))
            return None
        floor = forecast(closed, twin, errors)
        return Gap(
            segments,
            forecast(delivered, segments),
            refitted,
            last,
            floor,
            self._struck(found, segments, last),
            wrong,
            wrong_name,
            tuple(
                forecast(
                    one,
                    _misread(twin.thinned(limits.THINNED.value), after.layout, wrong),
                    errors,
                    floor.thinned(limits.THINNED.value),
                )
                for one, wrong in _redrawn(after, systematic)
            ),
            tuple(one.path.name for one in self.validate),
        )

    def _struck(self, found: Search | None, segments: Stretches, closed: Forecast) -> Forecast | None:
        """Predictions without what was named: an effect that is not there does not help them."""
        if found is None or not found.named:
            return None
        names = found.after.hypothesis.names
        value = found.after.value.copy()
        value[[names.index(candidate.name) for candidate in found.named]] = 0.0
        return forecast(realise(found.after.hypothesis, value), segments, (), closed) if found.after.physical else None

    def _sensors_first(
        self, refit: Study, after: Study, findings: Sequence[Finding], skewed: Sequence[Deflection]
    ) -> ArmFileFirst | None:
        """What has to be put right in the arm file before anything can be said; None where it is right."""
        h = self.arm.period_s
        if skewed:
            worst = max(skewed, key=lambda d: d.rms_rad)
            return SkewedEncoders(worst.joint, worst.skew_s)
        lags = [finding.value / h for finding in findings if finding.kind == "torque_lag"]
        # the arm file has one torque law for all joints: what is late at some of them is a drive
        if len(lags) == self.arm.n and (
            min(lags) > limits.SKEWED.value
            or any(max(abs(lag / part - 1.0) for lag in lags) < limits.LATE_ALIKE.value for part in (0.5, 1))
        ):
            return LateTorques(float(np.mean(lags)))
        # a twin that moves by a law of nearly the same form may be harder to follow than the arm itself
        quiet = _too_quiet(after) & _too_quiet(refit)
        if quiet.any():
            return DeclaredTooNoisy(float(np.min(after.excess[quiet])))
        return None

    def _judge(
        self, found: Search | None, findings: tuple[Finding, ...], values: tuple[Value, ...], gap: Gap | None
    ) -> Verdict:
        assert found is not None
        share = min(found.completeness)
        if not found.named and not excess(found.before):
            if not findings:
                return self._same_equations(found.after, values, gap)
        elif not found.named or share < limits.PARTLY.value:
            return Unexplained(
                float(np.nanmax(found.after.excess)),
                tuple(candidate.name for candidate in found.named),
                share,
                tuple(finding for finding in findings if finding.kind == "torque_gain"),
            )
        if gap is not None and gap.struck is not None and _worse(gap, gap.struck):
            return NotPredicted(findings, gap.closed.median, gap.struck.median)
        if any(finding.instead for finding in findings):
            return Inseparable(findings)
        return self._how_much(found, findings, gap)

    def _how_much(self, found: Search, findings: tuple[Finding, ...], gap: Gap | None) -> Verdict:
        """Whether effects are all that is missing, or a part of it, or only look like it."""
        most, apart_by = float(np.nanmax(found.after.excess)), unsteady(found)
        closed = closes(gap) if gap is not None else most <= limits.CLOSED_BALANCE.value
        unsigned = tuple(finding for finding in findings if not finding.signed)
        known = not unsigned or gap is None or closes_by_noise(gap)
        if min(found.completeness) >= limits.COMPLETE.value and closed and known and not apart_by:
            return Lacking(findings)
        apart = _explains_more_apart(found)
        if apart is not None:
            return Unexplained(most, (apart.name,), apart.complete, ())
        if unsigned:
            return Unexplained(
                most, tuple(one.name for one in found.named), min(found.completeness), (), unsigned=unsigned
            )
        return PartNamed(findings, remainders(self.arm, found.after, gap), apart_by)

    def _open(self, found: Search) -> bool:
        """Whether most of what is left over may be explained by other entries of the catalogue."""
        return excess(found.after) and (not found.named or min(found.completeness) < limits.COMPLETE.value)

    def _unsettled(self, found: Search) -> bool:
        """Whether the runs disagree, or nothing of the catalogue explains most of what is missing."""
        if not found.named and not excess(found.before):
            return bool(self._apart(found.after))
        return not found.named or min(found.completeness) < limits.PARTLY.value

    def _changed(self, found: Search, study: Study, layout: Layout) -> tuple[Changed | None, Search, Study | None]:
        """A change with time of what a study has, which explains it, the search with the study of what was recorded
        after it, and the study of what was recorded before. layout: what these have beside what begins."""
        listed = [one.name for one in study.layout.effects if possible(study.hypothesis, one)]
        change = find_change(study, listed)
        if change is None:
            return None, found, None
        begun = [study.layout.find(name) for name in change.names if name in listed]
        # errors of sensors that were found without the change stood for it
        kept = replace(layout, own=(*layout.own, *begun), loose=())
        applied = np.zeros_like(study.applied)
        plain = replace(
            study, records=self.measured, applied=applied, hypothesis=replace(study.hypothesis, layout=kept)
        )
        try:
            apart = settled(plain, change, limits.CLOSED_BALANCE.value)
        except (Undecided, ZygosError):
            return None, found, None
        if apart is None:
            return None, found, None
        change, now, was = apart
        names = tuple(record.path.name for record in study.records)
        taken = self._payload(change, now, was) if change.what == BODIES and was is not None else ()
        return Changed(change, names, taken), replace(found, after=now, named=(), sets=()), was

    def _payload(self, change: Change, now: Study, was: Study) -> tuple[PayloadValue, ...]:
        """What the last body took on, if that is what changed."""
        later, before = (
            one.of_twin(one.hypothesis).value[:, [one.hypothesis.names.index(name) for name in change.names]]
            for one in (now, was)
        )
        # twins are drawn with the same seeds: two that belong together would share their noise
        count = min(len(later), len(before))
        drawn = later[:count] - before[::-1][:count]
        return payload_of(self.arm, self.simulation, change.names, change.new - change.old, drawn)

    def _same_equations(self, study: Study, values: tuple[Value, ...], gap: Gap | None) -> Verdict:
        apart = self._apart(study)
        if apart:
            return RunsDisagree(apart)
        lost = None if gap is None else far_off(gap)
        if lost is not None:
            return lost
        changed = tuple(value for value in values if value.differs)
        return ValuesDiffer(changed) if changed else NothingMissing()

    def _remark_rest(self, study: Study, findings: tuple[Finding, ...], gap: Gap | None) -> None:
        """Note what an answer leaves over."""
        rho = float(np.nanmax(study.excess))
        if findings and excess(study):
            self.remarks.append(StillLeft(rho))
        for run in () if gap is None else unclosed(gap):
            assert gap is not None
            self.remarks.append(AboveFloor(gap.runs[run], gap.closed.of_run(run).median / gap.floor.of_run(run).median))
        apart = self._apart(study)
        if findings and apart:
            self.remarks.append(Disagreements(apart))

    def _apart(self, study: Study) -> tuple[Disagreement, ...]:
        """Parameters on which two runs disagree by more than their twins' noise and by more than a trifle."""
        hypothesis, (each, spread) = study.hypothesis, study.by_run
        units = dict(zip(self.arm.parameter_names, self.arm.parameter_units, strict=True))
        out = []
        for k, name in enumerate(hypothesis.names):
            if name not in units:
                continue
            own = units[name]
            largest = max(
                abs(float(x)) for x, n in zip(study.value, hypothesis.names, strict=True) if units.get(n) == own
            )
            least = limits.MATERIAL_DIFFERENCE.value * max(abs(float(study.value[k])), limits.MOVES.value * largest)
            pairs = [
                (abs(float(each[i, k] - each[j, k])) / float(np.hypot(spread[i, k], spread[j, k])), i, j)
                for i, j in combinations(range(len(each)), 2)
                if abs(each[i, k] - each[j, k]) > least
            ]
            z, i, j = max(pairs, default=(0.0, 0, 0))
            if z > limits.DISAGREE_Z.value:
                out.append(Disagreement(name, float(each[i, k]), float(each[j, k])))
        return tuple(out)

    def _through_the_gate(
        self, study: Study, values: tuple[Value, ...], findings: tuple[Finding, ...], verdict: Verdict, gap: Gap | None
    ) -> tuple[Adopted | None, Verdict, Gap | None]:
        """The model that is written, the verdict that goes with it, and the gap with the predictions of this model.

        Where the one with what was found does not pass, it is the simulation's own where nothing is missing, or else
        that of `zygos estimate`.
        """
        errors = sensor_effects(study.hypothesis, study.value)
        try:
            found = Adopted(self.arm, self._model(study, values, findings))
            if gap is None or isinstance(verdict, Changed):
                # a run may have been recorded before a change, and nobody says so
                return found, verdict, gap
            gap = replace(gap, closed=forecast(from_model(self.arm, found.model), gap.segments, errors))
            return Adopted(self.arm, found.model, self._beside(gap)), verdict, gap
        except NotAdopted as refused:
            failed = refused.failed
        self.remarks = [one for one in self.remarks if not isinstance(one, NearestArm)]
        others: list[tuple[Model, Verdict]] = (
            [(self.simulation, verdict)] if isinstance(verdict, NothingMissing) else []
        )
        others += [] if self.plain is None else [(self.plain, PlainEstimate(failed, findings))]
        for model, answer in others:
            with suppress(Undecided, ZygosError):
                if gap is None:
                    return Adopted(self.arm, model), answer, gap
                told = replace(gap, closed=forecast(from_model(self.arm, model), gap.segments))
                delivered = [("as delivered", told.delivered)]
                return Adopted(self.arm, model, self._beside(told, delivered)), answer, told
        return None, NotAdmissible(failed, findings), gap

    def _beside(self, gap: Gap, baselines: Sequence[tuple[str, Forecast]] = ()) -> tuple[Check, ...]:
        """The closed model beside the best baseline on each untouched run, in the median over its stretches and in what
        a tenth of them exceeds. baselines: those that count; by default all."""
        known = [*baselines]
        if not known:
            known = [("as delivered", gap.delivered), ("refit", gap.refit)]
            if self.plain is not None:
                with suppress(ZygosError):
                    known.append(("plain estimate", forecast(from_model(self.arm, self.plain), gap.segments)))
        checks = []
        for k, run in enumerate(gap.runs):
            found, floor = gap.closed.of_run(k), allowed_by(gap, k)
            each = [(name, one.of_run(k)) for name, one in known]
            for said, size, noise, sizes in (
                ("the median error of predictions", found.median, floor[0], [(n, x.median) for n, x in each]),
                ("the 90th percentile of the errors", found.tenth, floor[1], [(n, x.tenth) for n, x in each]),
            ):
                checks.append(no_worse(f"{said} of {run}", "sigma", size, sizes, limits.CLOSED.value * noise))
        return tuple(checks)

    def _model(self, study: Study, values: tuple[Value, ...], findings: tuple[Finding, ...]) -> Model:
        """The model with the values and effects that were learned; what it said of other effects is kept."""
        parameters = {
            v.name: Quantity(_damping(v), v.sigma if np.isfinite(v.found) else 0.0, "zygos", v.unit)
            for v in values
            if v.name in self.arm.parameter_names
        }
        _, effects = split(study.hypothesis, study.value)
        new = {(f.kind, f.joint, f.component): f for f in findings}
        kept: list[Effect] = []
        for effect in effects:
            finding = new.get((effect.kind.key, effect.joint, effect.component))
            if finding is not None:
                # a rotor that couples at all does so with its whole inertia
                value = 1.0 if effect.kind.key == "rotor_coupling" else finding.value
                kept.append(replace(effect, value=value, sigma=finding.sigma, evidence=entry_evidence(finding)))
            elif effect.source == "zygos":
                value, sigma = self._size(study, acting(effect, self.arm).name)
                # an effect of the simulation that the runs do not show leaves the model
                if value > limits.DIFFERS_Z.value * sigma or (
                    value < -limits.DIFFERS_Z.value * sigma and not effect.kind.positive
                ):
                    kept.append(replace(effect, value=value, sigma=sigma))
            else:
                kept.append(effect)
        return Model(f"{self.simulation.name}, explained", parameters=parameters, effects=tuple(kept))


def _damping(value: Value) -> float:
    """The value; 0 for a damping that is negative by its noise."""
    negative = value.unit == "Nms/rad" and -limits.DIFFERS_Z.value * value.sigma < value.found < 0.0
    return 0.0 if negative else value.found


def _own(refit: Study, basis: Study, found: Search) -> Study:
    """The refit that a search began with: with the errors of sensors that were found before anything was missing."""
    return found.before if basis is refit and found.before.layout.loose else refit


def _too_quiet(study: Study) -> NDArray[np.bool_]:
    """(runs, balances) whether a fit is better than noise allows: noise was taken out of its sums that was never
    there."""
    return np.asarray(study.excess**2 - 1.0 < -allowed(study)[0])


def _torques_too_quiet(study: Study) -> NDArray[np.bool_]:
    """(runs, balances that have torques) of `_too_quiet`. The momentum of the whole arm says nothing of the noise of
    its torques: it has none, and what is fitted to it beside balances that do not close is of little weight."""
    quiet, layout = _too_quiet(study), study.layout
    return quiet[:, [balance not in layout.momenta for balance in layout.balances]]


def _common_offset(study: Study) -> bool:
    """Whether torques that are taken to have noise have an offset for certain that is the same in all runs."""
    drawn = study.of_twin(study.hypothesis).zeros.std(axis=0, ddof=1)
    for k, name in enumerate(study.layout.zeros):
        each = study.zeros[:, k]
        certain = np.all(np.abs(each) > limits.DISAGREE_Z.value * drawn[:, k])
        if name.startswith("torque_zero") and certain and np.ptp(each) < limits.AGREE_SHARE.value * abs(each.mean()):
            return True
    return False


def _worse(gap: Gap, struck: Forecast) -> bool:
    """Whether the untouched run speaks against what was named: it is predicted better without. Where values are not
    known well, a run that closes may be predicted a little better by chance."""
    closed, floor = gap.closed.median, gap.floor.median
    clearly = closed > limits.CLEARLY.value * struck.median and closed > limits.CLOSED.value * floor
    return closed > struck.median and (clearly or not closes(gap))


def _predicts(gap: Gap) -> bool:
    """Whether the model after a change predicts the untouched runs, and much better than without the change: values
    that are learned from a part of the runs are not known well, and then much is allowed for."""
    return closes(gap) and gap.closed.median < limits.CHANGE_LEAVES.value * gap.refit.median


def _closes_before(study: Study | None) -> bool:
    """Whether nothing is left over before a change either, which has to do where no run was kept apart."""
    return study is not None and float(np.nanmax(study.excess)) <= limits.CLOSED_BALANCE.value


def _closes_with(study: Study | None, gap: Gap) -> bool:
    """Whether an untouched run closes with what was learned before a change: nobody says on which side of it it is."""
    if study is None:
        return False
    return _predicts(replace(gap, closed=forecast(study.dynamics(), gap.segments)))


def _explains_more(wider: Search, found: Search) -> bool:
    """Whether a search among more entries leaves less over, by more than a trifle."""
    share, before = (min(one.completeness) if one.named else 0.0 for one in (wider, found))
    return share > before + limits.TRIFLE.value or (share >= before and not excess(wider.after) and excess(found.after))


def _between_runs(study: Study, hypothesis: Hypothesis, part: Callable[[Array], Array]) -> Array:
    """Standard error that the disagreement of the runs gives a part of the coefficients; 0 of a single run."""
    each = np.array([part(study.of(hypothesis, [k]).value) for k in range(len(study.records))])
    return each.std(axis=0, ddof=1) / np.sqrt(len(each)) if len(each) > 1 else np.zeros(each.shape[1:])


def _explains_more_apart(found: Search) -> Candidate | None:
    """A candidate that by itself leaves far less over than all that was named, but has another size on each run: then
    a law that looks like it depends on something else, and what was named is not it. None where there is none."""
    left = 1.0 - min(found.completeness)
    listed = [one for one in found.rounds[0] if one.against == "inconsistent"]
    best = max(listed, key=lambda one: one.complete, default=None)
    return (
        best
        if best is not None and left > 1.0 - limits.MOSTLY.value and 1.0 - best.complete < limits.DOUBT.value * left
        else None
    )


def _redrawn(study: Study, systematic: float) -> list[tuple[Drives, Array]]:
    """Models whose values err as those of fits to the twins' draws, and by so large a share beside; with each the
    errors (zeros,) that the same fit makes of the sensors' errors. The offset of an untouched run is taken from itself,
    and errs as that of a measured run; a gain is the mean of all of them."""
    found = study.of_twin(study.hypothesis)
    drawn, zeros = found.value, found.zeros - found.zeros.mean(axis=0)
    own = np.where([name.startswith("torque_zero") for name in study.layout.zeros], zeros[:, 0], zeros.mean(axis=1))
    beside = systematic * np.random.default_rng(0).standard_normal(drawn[: limits.REDRAWN.value].shape) * study.value
    out = []
    for value, wrong in zip(
        study.value + drawn[: limits.REDRAWN.value] - drawn.mean(axis=0) + beside, own, strict=False
    ):
        # values of some draws are those of no arm
        with suppress(ZygosError):
            out.append((realise(study.hypothesis, value), wrong))
    return out


def _misread(stretches: Stretches, layout: Layout, wrong: Array) -> Stretches:
    """The stretches with torques from which so large errors (zeros,) are taken off that they do not have."""
    for size, error, torque in zip(wrong.tolist(), layout.errors.values(), layout.of_torque, strict=True):
        if torque:
            share, constant = (size, 0.0) if error.gain else (0.0, size)
            tau, before = (x - error.direction * (share * x + constant) for x in (stretches.tau, stretches.before))
            stretches = replace(stretches, tau=tau, before=before)
    return stretches


def _other(found: Search) -> Candidate | None:
    """The best candidate that was not named, nor cannot be told from one that was."""
    taken = {name for names in found.sets for name in names}
    return next((c for c in found.rounds[0] if c.name not in taken and (c.value > 0.0 or not c.kind.positive)), None)
