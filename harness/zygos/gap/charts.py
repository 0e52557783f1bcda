# SPDX-License-Identifier: MIT
"""The charts of an explained gap: which curves are drawn over what, thinned to what a screen shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Gap
from zygos.gap.residuals import (
    as_delivered,
    base_angle,
    freed,
    left_over,
    medians,
    middle,
    poor_segment,
    segment_errors,
    slope,
)
from zygos.gap.sentences import balance_title
from zygos.gap.torque import JointTorques, joint_torques
from zygos.gap.whereabouts import joint_of
from zygos.plan.separating import Separating
from zygos.report.page import Entry, joint_colour, numbers, series

Floats = NDArray[np.float64]

_POINTS = 1500
"""Of a line of a chart, and of all dots of a chart together."""
_BALANCES = 3
"""Failing balances that are drawn over time."""
_SUBJECTS = 2
"""And in phase space."""
_WINDOW_S = 0.1
"""Over which the slope of a residual is taken."""
_LONG_WINDOW_S = 1.0
"""The same for the momentum, which the noise of the gyro shakes."""
_BINS = 48
_IN_A_BIN = 10
"""Torques in a bin, on average, at least."""
_TORQUE_POINTS = 600
"""Of a line of torques, and of the dots of such a chart."""


def planned_chart(arm: Arm, planned: Separating) -> tuple[list[float | None], Entry]:
    """Times and the chart of the angles that a planned motion asks for; its id is `planned`."""
    names = [joint.name for joint in arm.joints]
    t = np.linspace(0.0, planned.scenario.duration_s, _POINTS // 2)
    angle, _ = planned.scenario.desired(names, t)
    lines = [series(name, joint_colour(j), angle[:, j]) for j, name in enumerate(names)]
    title = f"Desired angles of {planned.scenario.name}"
    return numbers(t), {
        "id": "planned", "title": title, "unit": "rad", "time": "planned", "domain": "planned", "axis": "s",
        "height": 200, "lines": [], "series": lines,
    }  # fmt: skip


class Charts:
    """The charts of a page by group, and the abscissae they share."""

    def __init__(self, x: Explanation, planned: Separating | None = None) -> None:
        """Draw all that an explanation has. planned: the motion that tells a set apart."""
        self.x, self.arm = x, x.arm
        self.times: dict[str, list[float | None]] = {}
        self.groups: dict[str, list[Entry]] = {
            "time": [],
            "phase": [],
            "signals": [],
            "overlay": [],
            "torque": [],
            "planned": [],
        }
        self.subject = ""
        """What the charts in phase space are about."""
        self.overlay = ""
        """Where the segment lies that is drawn in full."""
        self.closed = "best guess added" if x.answer in {"unknown", "cannot tell"} else "closed"
        left = self.left = left_over(x)
        self.balances = list(left.failing[:_BALANCES]) or [x.refit.hypothesis.balances[0]]
        models = [
            ("as delivered", "delivered", left.delivered),
            ("refit", "refit", left.refit),
            (self.closed, "closed", left.closed),
        ]
        self.models = [(label, colour, values) for label, colour, values in models if values is not None]
        """Label, colour and what is left over of run A's balances, (balances, A, instants)."""
        self._over_time()
        self._phase_space()
        if x.gap is not None:
            self._held_out(x.gap)
        self._torques()
        if planned is not None:
            self.times["planned"], chart = planned_chart(self.arm, planned)
            self.groups["planned"].append(chart)

    @property
    def data(self) -> Entry:
        """What the script of the page draws."""
        every = (chart for charts in self.groups.values() for chart in charts)
        return {"times": self.times, "refused": [], "charts": {chart["id"]: chart for chart in every}}

    def _lines(self, balance: int) -> list[tuple[str, str, Floats]]:
        """(A, instants) of one balance, from whom it can be drawn up."""
        every = ((label, colour, left[balance]) for label, colour, left in self.models)
        return [line for line in every if np.isfinite(line[2]).any()]

    def _over_time(self) -> None:
        """Residual of the failing balances over run A."""
        arcs, instants = self.left.state.q.shape[:2]
        chosen = np.arange(0, instants, max(1, math.ceil(arcs * instants / _POINTS)))
        time = self.left.record.time_s

        def flat(values: Floats) -> Floats:
            # a constant belongs to each arc: no line across
            return np.pad(values[:, chosen], ((0, 0), (0, 1)), constant_values=np.nan).ravel()

        self.times["run"] = numbers(np.concatenate([time[:, chosen], time[:, -1:]], axis=1).ravel())
        for k in self.balances:
            name = self.x.refit.layout.balances[k]
            self.groups["time"].append(
                {
                    "id": f"left-{k}",
                    "title": f"Left over: {balance_title(self.arm, name)}",
                    "unit": "J" if name == "E" else "N m s",
                    "time": "run",
                    "lines": [0.0],
                    "series": [series(label, colour, flat(left)) for label, colour, left in self._lines(k)],
                }
            )

    def _phase_space(self) -> None:
        """Slope of a failing balance's residual against rates and deflections."""
        layout, state = self.x.refit.layout, self.left.state
        subjects = self._subjects()
        self.subject = " and ".join(balance_title(self.arm, layout.balances[k]) for k in subjects)
        bare = self.left.struck
        for k in subjects:
            name, lines = layout.balances[k], self._lines(k)
            if name[0] == "H":
                self._momentum(name, lines)
                continue
            motor = joint_of(name)
            if motor is not None:
                joints, side, what, unit = [motor], "motor", "Missing torque", "N m"
            else:
                joints, side, what, unit = self._joints(), "link", "Missing power", "W"
            if bare is not None:
                lines.append(("without what was named", "without", bare[k]))
            for i in joints:
                joint, rate = self.arm.joints[i].name, (state.thetad if side == "motor" else state.qd)[..., i]
                deflection = state.theta[..., i] - state.q[..., i]
                title = f"{what} over the {side}'s rate, {joint}"
                self._scatter(f"rate-{i}", title, unit, "rad/s", lines, rate, _WINDOW_S)
                title = f"{what} over the deflection, {joint}"
                self._scatter(f"deflection-{i}", title, unit, "rad", lines, deflection, _WINDOW_S)

    def _subjects(self) -> list[int]:
        """Balances of motors if they fail, as they are local: those of named joints, else the worst; else what fails
        most. A joint that was rigid had no motor balance to fail."""
        names = self.x.refit.layout.balances
        springs = freed(self.x)
        bent = [k for k, name in enumerate(names) if joint_of(name) in springs]
        motors = [k for k in self.balances if joint_of(names[k]) is not None]
        named = [k for k in motors if self.x.findings and joint_of(names[k]) in self._joints()]
        return (bent or named or motors[:1] or self.balances[:1])[:_SUBJECTS]

    def _joints(self) -> list[int]:
        """Those that were named, else all."""
        names = [joint.name for joint in self.arm.joints]
        found = sorted({names.index(f.joint) for f in self.x.findings if f.joint is not None})
        return found or list(range(self.arm.n))

    def _momentum(self, name: str, lines: Sequence[tuple[str, str, Floats]]) -> None:
        """The momentum's residual over the base's rate, where a wrong gyro or constant shows, and in a plane its slope
        over the angle that the base has turned, where a torque on the base does."""
        rate = self.left.state.base
        along = f" along {name[1:]}" if name[1:] else ""
        title = f"Missing momentum{along} over the base's rate"
        own = rate if rate.ndim == 2 else rate[..., "xyz".index(name[1])]
        self._scatter(f"base-rate{name[1:]}", title, "N m s", "rad/s", lines, own, 0.0)
        if rate.ndim == 2:
            title = "Missing torque on the base over the angle it has turned"
            self._scatter("base-angle", title, "N m", "rad", lines, base_angle(self.left), _LONG_WINDOW_S)

    def _rates(self) -> list[str]:
        """The signals of the gyro that are predicted."""
        if not self.arm.free:
            return []
        return [f"rate of the base, {axis}" for axis in "xyz"] if self.arm.spatial else ["rate of the base"]

    def _scatter(
        self,
        name: str,
        title: str,
        unit: str,
        axis: str,
        lines: Sequence[tuple[str, str, Floats]],
        over: Floats,
        window_s: float,
    ) -> None:
        """Dots and medians in bins. window_s: the slope over so long is drawn; 0: the residual itself."""
        window = max(2, round(window_s / self.arm.period_s)) if window_s else 0
        at = middle(over, window)
        low, high = float(at.min()), float(at.max())
        edges = np.linspace(low, high, _BINS + 1)
        step = max(1, window, math.ceil(at.size * len(lines) / _POINTS))
        self.times[name] = numbers(0.5 * (edges[1:] + edges[:-1]))
        dots: list[Entry] = []
        curves: list[Entry] = []
        for label, colour, left in lines:
            y = slope(left, window, self.arm.period_s)
            if colour != "without":
                dots.append(series(label, colour, y.ravel()[::step], x=numbers(at.ravel()[::step]), dots=True))
            curves.append(series(label, colour, medians(at, y, edges), wide=True, dash=colour == "without"))
        self.groups["phase"].append(
            {
                "id": name,
                "title": title,
                "unit": unit,
                "time": name,
                "domain": name,
                "axis": axis,
                "height": 260,
                "lines": [0.0],
                "series": dots + curves,
            }
        )

    def _torques(self) -> None:
        """Torques of the first untouched run, and what the models leave of them over time, rate, angle, deflection."""
        if not self.x.validated:
            return
        studies = [("as delivered", "delivered", as_delivered(self.x)), ("refit", "refit", self.x.refit)]
        if self.x.closed is not self.x.refit:
            studies.append((self.closed, "closed", self.x.closed))
        for one in joint_torques(self.x.validated[0], [study for *_, study in studies]):
            named = zip(studies, one.needed, strict=True)
            lines = [(label, colour, needed) for (label, colour, _), needed in named if needed is not None]
            self._torques_of(one, lines)

    def _torques_of(self, one: JointTorques, lines: Sequence[tuple[str, str, Floats]]) -> None:
        name, joint = f"torque-{one.joint}", self.arm.joints[one.joint].name
        step = max(1, math.ceil(one.time.size / _TORQUE_POINTS))

        def flat(values: Floats) -> Floats:
            # nothing connects two arcs
            return np.pad(values[:, ::step], ((0, 0), (0, 1)), constant_values=np.nan).ravel()

        self.times[name] = numbers(np.concatenate([one.time[:, ::step], one.time[:, -1:]], axis=1).ravel())
        shown = [line for line in lines if line[1] != "refit"] if len(lines) > 2 else list(lines)
        torque = [series("measured", "soft", flat(one.measured), wide=True)]
        torque += [series(label, colour, flat(needed)) for label, colour, needed in shown]
        left = [(label, colour, one.measured - needed) for label, colour, needed in shown]
        charts = [("", f"Torque, {joint}", torque)]
        charts.append(("-left", f"Torque left over, {joint}", [series(a, b, flat(values)) for a, b, values in left]))
        for key, title, drawn in charts:
            self.groups["torque"].append(
                {
                    "id": name + key,
                    "joint": one.joint,
                    "title": title,
                    "unit": "N m",
                    "time": name,
                    "domain": name,
                    "axis": "s",
                    "height": 200,
                    "lines": [0.0],
                    "series": drawn,
                }
            )
        over = [("rate", "rad/s", one.rate), ("angle", "rad", one.angle), ("deflection", "rad", one.deflection)]
        for quantity, unit, values in over:
            if values is not None and left:
                title = f"Torque left over the {quantity}, {joint}"
                self._medians_of(f"{name}-{quantity}", title, unit, left, values, one.joint)

    def _medians_of(
        self,
        name: str,
        title: str,
        unit: str,
        lines: Sequence[tuple[str, str, Floats]],
        over: Floats,
        joint: int,
    ) -> None:
        bins = int(np.clip(over.size // _IN_A_BIN, 1, _BINS))
        edges = np.linspace(float(over.min()), float(over.max()), bins + 1)
        step = max(1, math.ceil(over.size * len(lines) / _TORQUE_POINTS))
        self.times[name] = numbers(0.5 * (edges[1:] + edges[:-1]))
        at = numbers(over.ravel()[::step])
        dots = [series(label, colour, y.ravel()[::step], x=at, dots=True) for label, colour, y in lines]
        curves = [series(label, colour, medians(over, y, edges), wide=True) for label, colour, y in lines]
        self.groups["torque"].append(
            {
                "id": name,
                "joint": joint,
                "title": title,
                "unit": "N m",
                "time": name,
                "domain": name,
                "axis": unit,
                "height": 200,
                "lines": [0.0],
                "series": dots + curves,
            }
        )

    def _held_out(self, gap: Gap) -> None:
        """Predictions of the untouched run: rms of every segment, and one segment in full."""
        half = gap.refit.residual.shape[1]
        time = gap.segments.time_s[:, half]
        chosen = poor_segment(gap)
        start = float(time[chosen])
        self.overlay = f"{start:.1f} … {start + limits.HORIZON_S.value:.1f} s"
        self.times["segments"] = numbers(time)
        self.times["ahead"] = numbers(gap.segments.time_s[chosen, half:] - start)
        models = [("refit", "refit", gap.refit)]
        if gap.closed is not gap.refit:
            models.append((self.closed, "closed", gap.closed))
        elif self.x.answer == "values differ":
            models.insert(0, ("as delivered", "delivered", gap.delivered))
        joints = [joint.name for joint in self.arm.joints]
        signals = [*(f"link angle, {j}" for j in joints), *(f"motor angle, {j}" for j in joints), *self._rates()]
        floor = gap.floor.signals
        for k, signal in enumerate(signals):
            self.groups["signals"].append(
                {
                    "id": f"signal-{k}",
                    "title": signal,
                    "unit": "σ rms",
                    "time": "segments",
                    "domain": "segments",
                    "axis": "s",
                    "height": 170,
                    "log": True,
                    "lines": [float(floor[k])] if floor[k] > 0.0 and math.isfinite(floor[k]) else [],
                    "series": [series(label, c, segment_errors(one)[:, k]) for label, c, one in models],
                }
            )
            self.groups["overlay"].append(
                {
                    "id": f"overlay-{k}",
                    "title": signal,
                    "unit": "σ",
                    "time": "ahead",
                    "domain": "ahead",
                    "axis": "s",
                    "height": 170,
                    "lines": [0.0],
                    "series": [series(label, c, one.residual[chosen, :, k]) for label, c, one in models],
                }
            )
