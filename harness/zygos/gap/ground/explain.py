# SPDX-License-Identifier: MIT
"""From runs of an arm on the ground and a simulation to a verdict: what is missing, where, and how much."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import CATALOGUE, Effect
from zygos.errors import Undecided, ZygosError
from zygos.gap.adopted import Adopted, Check, NotAdopted
from zygos.gap.changes import Change
from zygos.gap.findings import ASYMMETRY, Finding, Repeated, Value
from zygos.gap.ground.bias import confirmed
from zygos.gap.ground.candidates import OFFSET_OF_TORQUE, candidates_of
from zygos.gap.ground.changes import find_change
from zygos.gap.ground.columns import Layout, Table, table_of
from zygos.gap.ground.direction import one_sided
from zygos.gap.ground.explanation import GroundExplanation, GroundGap, JointRest
from zygos.gap.ground.fit import Fit, fit, jackknife, residual
from zygos.gap.ground.form import form_sigmas
from zygos.gap.ground.gravity import missing_gravity
from zygos.gap.ground.predictions import Prediction, Stage, predict, remainders, run_name
from zygos.gap.ground.search import Search, beside_all, in_time, is_gain, search, without
from zygos.gap.ground.sentences import gains, offset, unnamed
from zygos.gap.ground.shapes import open_shapes, with_best_shapes
from zygos.gap.ground.timing import lateness, torque_constants
from zygos.gap.sentences import entry_evidence
from zygos.gap.verdicts import (
    Changed,
    Inseparable,
    Lacking,
    LateTorques,
    NotAdmissible,
    NothingMissing,
    NotPredicted,
    PartNamed,
    PlainEstimate,
    Remainder,
    Unexplained,
    ValuesDiffer,
    Verdict,
    WrongGravity,
)
from zygos.ground.estimate import DEFAULT_FRICTION, at_best_span, complete, estimate_ground
from zygos.ground.motion import Motion
from zygos.ground.rows import friction
from zygos.ground.solution import Solution
from zygos.ground.twin import Twins, increments_floor, predicted_load
from zygos.model.model import Model, Quantity
from zygos.quantiles import normal_sf, student_factor, student_isf
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

COULOMB = "motor_coulomb"
BESIDE = "usual, and not sure enough to be named"
"""Evidence of an effect that stays in a model."""


def explain_ground(
    arm: Arm,
    simulation: Model,
    measured: Sequence[Run],
    validate: Sequence[Run] = (),
    step: Callable[[float, str], None] = lambda share, what: None,
    without: Sequence[str] = (),
) -> GroundExplanation:
    """Say what the simulation of an arm with a fixed base and rigid joints lacks.

    measured: runs that are learned from; a single one is cut into thirds, of which the last is kept apart. validate:
    runs from which nothing is learned. step is told the share done and what is being done. without: keys of effects
    that are not tried.

    Errors: ZygosError where the model or the runs do not fit the arm, or a run is too short; Undecided where there are
    fewer rows than unknowns.
    """
    if not arm.grounded:
        raise ZygosError(f"arm {arm.name} floats or has flexible joints; remedy: `explain_runs`")
    learned, apart = _parts(measured, validate)
    with threadpool_limits(limits=1):
        return _Explainer(arm, simulation, learned, apart, step, tuple(without)).explain()


class _Explainer:
    def __init__(
        self,
        arm: Arm,
        simulation: Model,
        measured: Sequence[Run],
        validate: Sequence[Run],
        step: Callable[[float, str], None],
        without: tuple[str, ...],
    ) -> None:
        self.without = without
        self.arm, self.simulation, self.measured, self.validate = arm, simulation, tuple(measured), tuple(validate)
        self.step = step
        self.usual = friction(arm, [CATALOGUE[key] for key in DEFAULT_FRICTION])
        """The effects of a plain estimate."""
        self.notes: list[str] = []

    def explain(self) -> GroundExplanation:
        self.step(0.05, "the motion of the runs")
        motions = [Motion.of(run) for run in self.measured]
        span, _, rough = at_best_span(self.arm, motions, self.usual)
        if self.arm.torque_unit == "A":
            motions = self._in_nm(motions, span)
            span, _, rough = at_best_span(self.arm, motions, self.usual)
        self.step(0.3, "the columns of all candidates")
        values = rough.value[: len(self.arm.parameter_names)]
        table, found = self._searched(motions, span, values, wide=False)
        self.step(0.7, "every entry of the catalogue")
        wider = self._searched(motions, span, self._bodies(table, found), wide=True, begun=found)
        if self._explains_more(wider, (table, found)):
            table, found = wider
        else:
            found = beside_all(wider[0], found)
        table, found = with_best_shapes(
            self.simulation, table, found, self._bodies(table, found), lambda name: self.step(0.75, f"found {name}")
        )
        self.step(0.77, "the twin of what was found")
        twins = Twins()
        found = confirmed(self.simulation, table, found, stage_of(table.layout, "closed", found.after), twins)
        found = in_time(table, found)
        if not found.last and all(is_gain(one.candidate) for one in found.named):
            found = beside_all(table, found)
        self.step(0.78, "changes within and between runs")
        found, changed = _changed(table, found)
        self.step(0.8, "predictions of the untouched runs")
        sizes = _Sizes.of(table, found)
        forms = form_sigmas(self.simulation, table, found, stage_of(table.layout, "closed", found.after), twins)
        findings = self._findings(found, sizes, forms)
        findings = (*findings, *self._directions(table, found, findings, sizes))
        gap = self._gap(table, found, rough)
        left = _Increments.of(table, found, twins)
        values_found = self._values(table, sizes)
        verdict = self._arm_file_first(table)
        if verdict is None and changed is not None:
            verdict = Changed(changed[0], tuple(run_name(run, k) for k, run in enumerate(self.measured, 1)))
        verdict = verdict or self._judge(found, findings, values_found, gap, left)
        known = not isinstance(verdict, Unexplained | NotPredicted | LateTorques | WrongGravity)
        self.step(0.95, "verdict")
        likely = self._model(table, found, findings, values_found, sizes, verdict) if known else None
        adopted, verdict = self._through_the_gate(likely, verdict, findings, gap)
        if adopted is not None and adopted.model is likely and (more := found.unnamed(table.layout)):
            self.notes.append(unnamed(self.arm, [one.name for one in more]))
        if adopted is not None and adopted.model is not likely:
            values_found = self._values_of(adopted.model)
            if gap is not None:
                gap = gap.closed_by(Stage.of("plain estimate", adopted.model, self.arm))
                if isinstance(verdict, PlainEstimate):
                    verdict = replace(verdict, left=remainders(gap.predictions))
        return GroundExplanation(
            self.arm,
            self.simulation,
            self.measured,
            verdict,
            findings if known and not isinstance(verdict, PlainEstimate | NotAdmissible) else (),
            values_found,
            found,
            self._joints(table, found, left),
            gap,
            span,
            adopted,
            tuple(self.notes),
            likely,
        )

    def _arm_file_first(self, table: Table) -> Verdict | None:
        """What has to be put right in the arm file before anything can be said; None where it is right."""
        pull = missing_gravity(table, self.simulation)
        if pull is not None:
            x, y, z = (pull + self.arm.gravity).tolist()
            return WrongGravity((x, y, z), self.arm.gravity)
        late = lateness(table)
        return None if late is None else LateTorques(late)

    def _through_the_gate(
        self, likely: Model | None, verdict: Verdict, findings: tuple[Finding, ...], gap: GroundGap | None
    ) -> tuple[Adopted | None, Verdict]:
        """The model that is written, and the verdict that goes with it. Where the one with what was found does not
        pass, or there is none, it is that of `zygos estimate`, if that one passes.

        likely: with what was found; None where nothing is known.
        """
        if isinstance(verdict, LateTorques | WrongGravity) or (likely is None and gap is None):
            return None, verdict
        failed: tuple[Check, ...] = ()
        if likely is not None and not isinstance(verdict, Inseparable):
            # a run may have been recorded before a change, and nobody says so
            beside = () if gap is None or isinstance(verdict, Changed) else gap.comparisons()
            try:
                return Adopted(self.arm, likely, beside), verdict
            except NotAdopted as refused:
                failed = refused.failed
        try:
            # where nothing is known, it has to be an answer by itself
            beside = () if gap is None else gap.plain_beside_delivered(alone=not failed)
            plain = Adopted(self.arm, self._plain(), beside)
        except Undecided:
            return None, NotAdmissible(failed, findings) if failed else verdict
        return plain, verdict if isinstance(verdict, Inseparable) else PlainEstimate(failed, findings)

    def _plain(self) -> Model:
        """The estimate with friction at every motor. Errors: Undecided where it is refused."""
        return complete(estimate_ground(self.measured, effects=self.usual, doubtful=True).to_model(), self.arm)

    def _values_of(self, model: Model) -> tuple[Value, ...]:
        """Of another model than that with what was found."""
        delivered = self.simulation.base_parameters(self.arm)
        return tuple(
            Value(name, now.unit, delivered[name].value, delivered[name].sigma, now.value, now.sigma)
            for name, now in model.base_parameters(self.arm).items()
        )

    def _searched(
        self, motions: Sequence[Motion], span: float, values: Floats, *, wide: bool, begun: Search | None = None
    ) -> tuple[Table, Search]:
        """The search among the usual entries of the catalogue, or among all. values: of the bodies and rotors, which
        predict the load."""
        listed = candidates_of(self.arm, self.simulation, self.without, wide=wide)
        layout = Layout.of(self.arm, self.simulation, listed, len(motions))
        table = table_of(layout, motions, span, [predicted_load(motion, values) for motion in motions])
        self.step(0.5, "candidates")
        found = search(table, lambda name: self.step(0.6, f"found {name}"), begun)
        if found.named and begun is None:
            self.step(0.65, "the load with what was found")
            loads = [predicted_load(motion, self._bodies(table, found)) for motion in motions]
            table = table_of(layout, motions, span, loads)
            found = search(table, lambda name: self.step(0.67, f"found {name}"), found)
        return table, found

    def _bodies(self, table: Table, found: Search) -> Floats:
        """Values of bodies and rotors with what was found."""
        own = len(self.arm.parameter_names)
        return np.asarray(table.layout.start[:own] + found.after.x[:own], dtype=np.float64)

    def _explains_more(self, wider: tuple[Table, Search], usual: tuple[Table, Search]) -> bool:
        """Whether a search among more entries leaves a good deal less over of the runs that were learned from.

        Each joint counts in units of its noise: the residual of a large one would hide what the others show."""
        names = {one.name for one in usual[1].named}
        if all(one.name in names for one in wider[1].named):
            return False
        unit = np.fmin(wider[0].floor, usual[0].floor) ** 2
        after, before = (float(np.sum(residual(table, found.after.x) / unit)) for table, found in (wider, usual))
        return after < limits.LATE_LEAVE.value * before

    def _in_nm(self, motions: Sequence[Motion], span: float) -> list[Motion]:
        """The motions with currents turned into torques; the runs as well."""
        constants = torque_constants(motions, self.simulation, span)
        self.measured, self.validate = (
            tuple(replace(run, frames=None, table=replace(run.cycles, tau=run.cycles.tau * constants)) for run in runs)
            for runs in (self.measured, self.validate)
        )
        each = ", ".join(f"{j.name} {k:.4g}" for j, k in zip(self.arm.joints, constants.tolist(), strict=True))
        self.notes.append(
            "the torques are motor currents: with the simulation's own values one ampere is "
            f"{each} Nm; all values are relative to these constants, whose errors look like those of masses"
        )
        return [Motion.of(run) for run in self.measured]

    def _findings(self, found: Search, sizes: _Sizes, forms: dict[str, float]) -> tuple[Finding, ...]:
        """What was named; gains of torque sensors within their usual errors are a note, because every arm has them.
        forms: what the forms of laws leave open of their sizes."""
        listed, usual = [], []
        for k, one in enumerate(found.named):
            finding = self._finding(found, k, sizes)
            finding = replace(finding, sigma=float(np.hypot(finding.sigma, forms.get(one.name, 0.0))))
            if (
                not is_gain(one.candidate)
                or abs(finding.value) > limits.GAIN_OFF.value + limits.DIFFERS_Z.value * finding.sigma
            ):
                listed.append(finding)
            else:
                usual.append(finding)
        if usual:
            self.notes.append(gains(self.arm, usual))
        return tuple(listed)

    def _finding(self, found: Search, index: int, sizes: _Sizes) -> Finding:
        one = found.named[index]
        value, sigma = sizes.at(one.name)
        effect = one.candidate.effect
        return Finding(
            one.candidate.key,
            self.arm.joints[one.candidate.joint].name,
            value,
            sigma,
            one.candidate.unit,
            Repeated(one.z, one.explained, one.each),
            tuple(found.sets[index][1:]),
            shape=None if effect is None else effect.shape,
            entry=None if effect is None else effect.kind,
        )

    def _directions(
        self, table: Table, found: Search, findings: Sequence[Finding], sizes: _Sizes
    ) -> tuple[Finding, ...]:
        """Offsets of torques that may as well be a Coulomb friction that differs between the directions."""
        friction = {e.joint: e.value for e in self.simulation.effects if e.kind.key == COULOMB}
        friction |= {f.joint: f.value for f in findings if f.kind == COULOMB}
        out = []
        for one in one_sided(
            table,
            found.after,
            sizes.variance,
            {j: friction.get(joint.name, 0.0) for j, joint in enumerate(self.arm.joints)},
        ):
            joint = self.arm.joints[one.joint].name
            if one.answer == "offset":
                self.notes.append(offset(joint, one.value, one.sigma))
                continue
            key = ASYMMETRY if one.answer == "friction" else OFFSET_OF_TORQUE
            instead = (f"{ASYMMETRY}{one.joint + 1}",) if one.answer == "either" else ()
            proof = Repeated(one.z, float("nan"), one.each)
            out.append(Finding(key, joint, one.value, one.sigma, "Nm", proof, instead, entry=CATALOGUE.get(key)))
        return tuple(out)

    def _values(self, table: Table, sizes: _Sizes) -> tuple[Value, ...]:
        layout, own = table.layout, len(self.arm.parameter_names)
        listed = []
        named = set(layout.held)
        delivered = self.simulation.base_parameters(self.arm)
        spread = [delivered[name].sigma for name in self.arm.parameter_names] + [e.sigma for e in layout.own]
        for k, name in enumerate(layout.names[: own + len(layout.own)]):
            if k in named:
                continue
            value, sigma = sizes.at(name)
            listed.append(
                Value(name, layout.units[k], float(layout.start[k]), float(spread[k]), value, sigma * sizes.wide(name))
            )
        return tuple(listed)

    def _gap(self, table: Table, found: Search, plain: Solution) -> GroundGap | None:
        """Predictions of the untouched runs. plain: the estimate with friction at every motor."""
        if not self.validate:
            self.notes.append("no run was kept apart, so that nothing says how well the result predicts another run")
            return None
        p = len(self.arm.parameter_names)
        baselines = (
            Stage("as delivered", table.layout.start[:p], tuple(self.simulation.effects)),
            stage_of(table.layout, "refit", found.before),
            Stage(
                "plain estimate",
                plain.value[:p],
                tuple(replace(e, value=max(float(x), 0.0)) for e, x in zip(self.usual, plain.value[p:], strict=True)),
            ),
        )
        gap = GroundGap(tuple(predict(run, *baselines) for run in self.validate), baselines)
        return gap.closed_by(stage_of(table.layout, "closed", found.after))

    def _judge(
        self,
        found: Search,
        findings: tuple[Finding, ...],
        values: tuple[Value, ...],
        gap: GroundGap | None,
        left: _Increments,
    ) -> Verdict:
        closes = self._closes(gap, left)
        if not findings:
            if not closes:
                return self._unexplained(found, gap, left)
            changed = tuple(value for value in values if value.differs)
            return ValuesDiffer(changed) if changed else NothingMissing()
        if gap is not None:
            with_them, without = _left(gap.predictions, "closed"), _left(gap.predictions, "refit")
            if with_them > limits.NOT_WORSE.value * without:
                return NotPredicted(findings, with_them, without)
        # a constant torque is free in every run: what it is does not touch the other findings
        beside = [f for f in findings if f.instead and f.kind in (ASYMMETRY, OFFSET_OF_TORQUE)]
        if len(beside) == len(findings) or any(f.instead for f in findings if f not in beside):
            return Inseparable(findings)
        if not closes:
            return PartNamed(findings, self._rest(gap, left))
        return Lacking(findings)

    def _closes(self, gap: GroundGap | None, left: _Increments) -> bool:
        """Whether noise alone is left: in the predictions of untouched runs, whose floor is known less well, and in the
        increments of the measured ones, where small effects show."""
        predicted = gap is None or all(one.closes for one in gap.predictions)
        return predicted and bool(np.all(left.over <= limits.CLOSED_BALANCE.value))

    def _rest(self, gap: GroundGap | None, left: _Increments) -> tuple[Remainder, ...]:
        """What is left over of untouched runs, or else of the measured ones, the largest first."""
        untouched = () if gap is None else remainders(gap.predictions)
        if untouched:
            return untouched
        out = []
        for j, joint in enumerate(self.arm.joints):
            run = int(np.argmax(left.over[:, j]))
            if left.over[run, j] > limits.CLOSED_BALANCE.value:
                name = f"the {joint.name} in {run_name(self.measured[run], run + 1)}"
                out.append(Remainder(name, float(left.torque[run, j]), "Nm", float(left.floor[run, j]), "", 0.0))
        return tuple(sorted(out, key=lambda rest: -rest.size))

    def _unexplained(self, found: Search, gap: GroundGap | None, left: _Increments) -> Unexplained:
        predicted = max((one.worst for one in gap.predictions), default=0.0) if gap is not None else 0.0
        untouched = predicted > limits.CLOSED.value
        worst = predicted if untouched else float(left.over.max())
        near = found.nearest
        if near is None or near.explained <= 0.0:
            return Unexplained(worst, (), 0.0, (), untouched)
        return Unexplained(worst, (near.name,), min(1.0, near.explained), (), untouched)

    def _joints(self, table: Table, found: Search, left: _Increments) -> tuple[JointRest, ...]:
        stages = [_torque_left(table, x) for x in (np.zeros_like(found.before.x), found.before.x)]
        return tuple(
            JointRest(joint.name, *(tuple(float(x) for x in one[:, j]) for one in (*stages, left.torque, left.floor)))
            for j, joint in enumerate(self.arm.joints)
        )

    def _model(
        self,
        table: Table,
        found: Search,
        findings: tuple[Finding, ...],
        values: tuple[Value, ...],
        sizes: _Sizes,
        verdict: Verdict,
    ) -> Model:
        by_name = {value.name: value for value in values}
        parameters = {}
        for name, was in self.simulation.base_parameters(self.arm).items():
            value = by_name.get(name)
            if value is not None:
                parameters[name] = Quantity(value.found, value.sigma, "zygos", was.unit)
            else:
                parameters[name] = was
        effects = []
        for effect in self.simulation.effects:
            value = by_name.get(effect.column(self.arm))
            effects.append(
                effect if value is None else replace(effect, value=value.found, sigma=value.sigma, source="zygos")
            )
        by_place = {(finding.kind, finding.joint): finding for finding in findings}
        for one in found.named:
            finding = by_place.get((one.candidate.key, self.arm.joints[one.candidate.joint].name))
            if finding is None:
                continue
            if one.candidate.effect is None:
                unit = parameters[one.name].unit
                parameters[one.name] = Quantity(finding.value, finding.sigma, "zygos", unit)
            else:
                effects.append(
                    replace(
                        one.candidate.effect,
                        value=finding.value,
                        sigma=finding.sigma,
                        source="zygos",
                        evidence=entry_evidence(finding),
                    )
                )
        for candidate in found.unnamed(table.layout):
            size, sigma = sizes.at(candidate.name)
            if candidate.effect is None:
                parameters[candidate.name] = Quantity(size, sigma, "zygos", candidate.unit)
            else:
                effects.append(replace(candidate.effect, value=size, sigma=sigma, source="zygos", evidence=BESIDE))
        if isinstance(verdict, Changed):
            effects += self._begun(table, verdict, [effect.column(self.arm) for effect in effects])
        return Model(f"{self.simulation.name}, explained", parameters=parameters, effects=tuple(effects))

    def _begun(self, table: Table, verdict: Changed, known: Sequence[str]) -> list[Effect]:
        """The effects that a change brought: the model is that of the arm after it."""
        change = verdict.change
        sizes = dict(zip(change.names, zip(change.new.tolist(), change.sigma.tolist(), strict=True), strict=True))
        return [
            replace(
                one.effect,
                value=sizes[one.name][0],
                sigma=sizes[one.name][1],
                source="zygos",
                evidence=f"not there before {verdict.runs[change.run]}",
            )
            for one in table.layout.candidates
            if one.effect is not None
            and one.name in sizes
            and one.name not in known
            and (sizes[one.name][0] > 0.0 or not one.positive)
        ]


def _changed(table: Table, found: Search) -> tuple[Search, tuple[Change, Fit] | None]:
    """What changed, and the search with the fit of what was recorded after it."""
    changed = find_change(table, found.after)
    if changed is None:
        return found, None
    # what the usual friction took up is the change's
    bare = without(table, found, [one.name for one in found.unnamed(table.layout)])
    again = find_change(table, bare.after)
    found, changed = (found, changed) if again is None else (bare, again)
    return replace(found, after=changed[1]), changed


class _Sizes:
    """Values and standard deviations of the free columns of a fit."""

    def __init__(self, layout: Layout, fitted: Fit, sigma: Floats, freedom: Floats) -> None:
        self.layout, self.fitted = layout, fitted
        self._sigma = dict(zip(fitted.free, sigma.tolist(), strict=True))
        self._freedom = dict(zip(fitted.free, freedom.tolist(), strict=True))

    @property
    def variance(self) -> dict[int, tuple[float, float]]:
        """Standard deviation of each free column, and its degrees of freedom."""
        return {k: (self._sigma[k], self._freedom[k]) for k in self._sigma}

    @classmethod
    def of(cls, table: Table, found: Search) -> _Sizes:
        """With the shapes of laws open: their coefficients are then those of two neighbouring shapes together."""
        fitted, pairs = found.after, open_shapes(table, found.named)
        if not pairs:
            covariance, freedom, spread = jackknife(table, fitted)
            return cls(table.layout, fitted, np.maximum(np.sqrt(np.diag(covariance)), spread), freedom)
        wider = fit(table, [*fitted.free, *(other for _, other in pairs)], fitted.sigma)
        both = np.eye(len(fitted.free), len(wider.free))
        for k, (own, _) in enumerate(pairs):
            both[fitted.free.index(own), len(fitted.free) + k] = 1.0
        covariance, freedom, _ = jackknife(table, wider)
        spread = jackknife(table, fitted)[2]
        sigma = np.sqrt(np.diag(both @ covariance @ both.T))
        return cls(table.layout, fitted, np.maximum(sigma, spread), freedom[: len(fitted.free)])

    def at(self, name: str) -> tuple[float, float]:
        """Value, and the standard deviation of a normal variable with the same 95 % interval."""
        k = self.layout.at(name)
        value = float(self.layout.start[k] + self.fitted.x[k])
        freedom = self._freedom.get(k, 2.0)
        return value, self._sigma.get(k, 0.0) * float(
            student_factor(limits.CONFIDENCE.value, freedom)
        ) / limits.INTERVAL_Z.value

    def wide(self, name: str) -> float:
        """Factor by which a 99.7 % interval is wider than that of a normal variable with the same 95 % interval."""
        freedom = self._freedom.get(self.layout.at(name), 2.0)
        own = student_isf(normal_sf(limits.DIFFERS_Z.value), freedom) / limits.DIFFERS_Z.value
        return float(own / (student_factor(limits.CONFIDENCE.value, freedom) / limits.INTERVAL_Z.value))


def stage_of(layout: Layout, name: str, fitted: Fit) -> Stage:
    """The model of a fit."""
    p = len(layout.arm.parameter_names)
    values = layout.start + fitted.x[: layout.shared]
    effects = [
        replace(effect, value=float(value))
        for effect, value in zip(layout.effects, values[p:], strict=True)
        if value != 0.0
    ]
    return Stage(name, values[:p], tuple(effects))


@dataclass(frozen=True)
class _Increments:
    """What is left over of the increments of R measured runs at N joints, as mean torque, Nm."""

    torque: Floats
    """(R, N)"""
    floor: Floats
    """(R, N) what the model leaves of its own twin, and at least what noise does."""

    @property
    def over(self) -> Floats:
        """(R, N)"""
        return np.asarray(self.torque / self.floor, dtype=np.float64)

    @classmethod
    def of(cls, table: Table, found: Search, known: Twins) -> _Increments:
        model = stage_of(table.layout, "closed", found.after)
        twins = [increments_floor(rows, model.values, model.effects, known) for rows in table.rows]
        floor = np.fmax(np.array(twins), table.floor) / table.span_s
        return cls(_torque_left(table, found.after.x), floor)


def _torque_left(table: Table, x: Floats) -> Floats:
    """(R, N) mean torque over an increment that the values x leave, as standard deviation, Nm."""
    return np.asarray(np.sqrt(residual(table, x)) / table.span_s, dtype=np.float64)


def _left(predictions: Sequence[Prediction], name: str) -> float:
    """Root mean square over runs and evaluated joints of the torque that a model leaves, in floors."""
    each = [
        (joint.error_nm / least) ** 2
        for one in predictions
        for joint, least, told in zip(dict(one.scores)[name].joints, one.floor_nm, one.evaluated, strict=True)
        if told
    ]
    return float(np.sqrt(np.mean(each))) if each else 0.0


def _parts(measured: Sequence[Run], validate: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """The runs; a single measured one is cut into two, and a third part is kept apart unless there is another run."""
    if not measured:
        raise ZygosError("no measured run; remedy: one run, or better two to learn from and a third to validate")
    if len(measured) > 1:
        return tuple(measured), tuple(validate)
    parts = cut(measured[0], 2 if validate else 3)
    return parts[:2], tuple(validate) or parts[2:]


def cut(run: Run, parts: int) -> tuple[Run, ...]:
    """A run cut into parts of equal length, as if each had been recorded by itself. Errors: ZygosError where it is too
    short."""
    length = len(run) // parts
    if length * run.arm.period_s < limits.SHORTEST_S.value:
        raise ZygosError(
            f"{run.path or 'the run'}: one run of {len(run) * run.arm.period_s:.1f} s cannot be cut into {parts} "
            "parts, of which one must hold what another says; remedy: give two runs, or a longer one"
        )
    own = run.cycles
    return tuple(
        Run(run.arm, table=_piece(own, k * length, (k + 1) * length), path=run.path, damage=run.damage)
        for k in range(parts)
    )


def _piece(cycles: Cycles, start: int, stop: int) -> Cycles:
    of = slice(start, stop)
    return Cycles(cycles.sync[of], cycles.q[of], cycles.theta[of], cycles.tau[of], cycles.omega[of], cycles.flags[of])


def of_effects(effects: Sequence[Effect]) -> dict[tuple[str, str | None], Effect]:
    """Effects by kind and joint."""
    return {(effect.kind.key, effect.joint): effect for effect in effects}
