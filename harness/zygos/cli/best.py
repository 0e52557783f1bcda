# SPDX-License-Identifier: MIT
"""The values that `zygos estimate` publishes: refined ones where all rules hold, otherwise those of energy rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from zygos.can.run import Run
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import Estimation
from zygos.model.model import Model
from zygos.native.refiner import NORMAL_95
from zygos.refinement.refine import Refinement, check_supported, refine_runs
from zygos.refinement.sections import answer_of
from zygos.report.answer import Answer, Charts, Section, Text, section, table
from zygos.report.figures import down_to, figure, listed, unit_of


@dataclass(frozen=True, eq=False)
class Best:
    """An estimate from energy rows, and what its refinement came to."""

    energy: Estimation
    refined: Refinement | None
    """None where it did not begin or did not end."""
    reason: str
    """Why the values are those of energy rows; empty where they are refined."""

    @property
    def published(self) -> Refinement | None:
        """The refinement, where all its rules hold."""
        return None if self.reason else self.refined

    @property
    def model(self) -> Model:
        """The model to write. Errors: Undecided where the estimate was refused."""
        return (self.published or self.energy).to_model()

    def values(self) -> list[dict[str, Any]]:
        """What is published of each parameter, from where, and why: the entry `values` of the JSON."""
        out: list[dict[str, Any]] = [
            {**vars(one), "source": "energy balance", "reason": self.reason} for one in self.energy.values()
        ]
        better = self.published
        if better is None:
            return out
        columns = {one.name: (one.value, one.sigma) for one in better.values()} | {
            one.column(better.arm): (one.value, one.sigma) for one in better.effects
        }
        for entry in out:
            if entry["name"] in columns:
                value, sigma = columns[entry["name"]]
                entry |= {
                    "value": value,
                    "sigma": sigma,
                    "half95": NORMAL_95 * sigma,
                    "source": "refined",
                    "reason": "all rules of the refinement hold",
                }
            else:
                entry["reason"] = "the refinement does not estimate it"
        return out

    def as_dict(self) -> dict[str, Any]:
        """The entries that the JSON of an estimate has besides those of the energy rows."""
        found = self.refined
        return {
            "refinement": {
                "published": not self.reason,
                "reason": self.reason or None,
                "cycles": None if found is None else found.record.cycles,
                "left_out": None if found is None else found.record.left_out,
                "covariance": None if self.published is None else self.published.covariance.tolist(),
            },
            "values": self.values(),
        }

    def answer(self, energy: Answer, *, draw: bool = False) -> Answer:
        """The answer of the energy rows, with the published values in front, and what was checked of the refinement
        behind it; draw: with its charts."""
        values = self.values()
        better = self.published
        if better is None:
            said = f"The values are those of the energy balance, not refined: {self.reason}."
        else:
            said = "The values are refined: all rules of the refinement hold"
            part = better.part
            said += f". Only {part} were refined, to stay within the memory of a refinement." if part else "."
        rows = [
            (one["name"], down_to(one["value"], one["sigma"]), figure(one["half95"], 2), unit_of(one["unit"]),
             one["source"], one["reason"])
            for one in values
            if one["value"] == one["value"]
        ]  # fmt: skip
        part_of_page = section(
            "published",
            "Published values",
            Text(said),
            table("parameter::name | value::main | ± 95 % | unit::unit | from::text | why::wrap", rows),
        )
        behind, drawn = ((), {}) if self.refined is None else _of_refinement(self.refined, draw)
        shown = listed(*([one[key] for one in values] for key in ("name", "unit", "value", "half95")))
        return replace(
            energy,
            lead=(*energy.lead, Text(said, "note", "Values")),
            sections=(*(() if part_of_page is None else (part_of_page,)), *map(_of_energy, energy.sections), *behind),
            drawn={**energy.drawn, **{key: {**energy.drawn[key], **more} for key, more in drawn.items()}},
            brief=shown,
        )


def _of_energy(one: Section) -> Section:
    """A section of the energy balance, under a title that tells its values from the published ones."""
    return replace(one, title="Values of the energy balance") if one.key == "parameters" else one


def _of_refinement(found: Refinement, draw: bool) -> tuple[tuple[Section, ...], Mapping[str, Mapping[str, Any]]]:
    """Sections and charts of a refinement, with keys of their own."""
    whole = answer_of(found, draw=draw)

    def own(content: Any) -> Any:
        return replace(content, ids=tuple(map(_own, content.ids))) if isinstance(content, Charts) else content

    parts = tuple(
        Section(_own(one.key), f"Refinement: {one.title[0].lower()}{one.title[1:]}", tuple(map(own, one.content)))
        for one in whole.sections
    )
    charts = {
        _own(key): {**chart, "id": _own(chart["id"]), **({"time": _own(chart["time"])} if "time" in chart else {})}
        for key, chart in whole.drawn["charts"].items()
    }
    return parts, {"times": {_own(key): times for key, times in whole.drawn["times"].items()}, "charts": charts}


def _own(key: str) -> str:
    return f"refined-{key}"


def best_of(energy: Estimation, runs: Sequence[Run], model: Model | None, progress: Callable[[float], None]) -> Best:
    """Try to refine an estimate from energy rows of the same runs."""
    if energy.validity not in ("valid", "partial"):
        return Best(energy, None, f"the estimate from energy rows is {energy.validity}")
    try:
        check_supported(energy.watch.flight.arm, energy.watch.flight.effects)
        refined = refine_runs(runs, model=model, energy=energy, progress=progress)
    except (ZygosError, Undecided) as left:
        return Best(energy, None, str(left).partition("; remedy:")[0])
    return Best(energy, refined, refined.reason)
