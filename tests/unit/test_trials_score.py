# SPDX-License-Identifier: MIT
"""The scorer, on made-up verdicts of every kind, and the figures that the ledger gives."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import binomtest

if not os.environ.get("CI"):  # there, a missing tool is a failure
    pytest.importorskip("mujoco")

from oracles import ledger
from oracles.score import True_, Truth, multiple, overlaps, score

JOINTS = ("shoulder", "elbow")
COULOMB = True_("motor_coulomb", "elbow", 0.03, True, ("motor_stribeck",), False, 50.0)
OTHER = True_("motor_coulomb", "elbow", 0.03, False, ("motor_stribeck",), False, 50.0)
OUTSIDE = True_("", "elbow", 0.03, False, ("motor_viscous",), False, 50.0)


def named(*pairs: tuple[str, str | None], answer: str = "named", instead: tuple[str, ...] = (), value: float = 0.03):  # type: ignore[no-untyped-def]
    return {
        "answer": answer,
        "findings": [
            {
                "effect": effect,
                "joint": joint,
                "value": value,
                "interval": [value - 0.001, value + 0.001],
                "cannot_tell_from": list(instead),
            }
            for effect, joint in pairs
        ],
    }


def judged(true: Truth, verdict: dict[str, Any]) -> dict[str, Any]:
    return score(true, verdict, JOINTS)


def test_nulls() -> None:
    null = Truth("null", "nothing missing")
    for answer in ("nothing missing", "values differ"):
        assert judged(null, {"answer": answer})["right"]
        assert not judged(null, {"answer": answer})["false"]
    for answer in ("named", "part named", "cannot tell"):
        found = judged(null, named(("motor_coulomb", "elbow"), answer=answer))
        assert found["false"] and not found["right"] and found["extra"] == 1
    for answer in ("unknown", "refused"):
        found = judged(null, {"answer": answer, "sentence": ""})
        assert not found["false"] and not found["right"]


def test_the_effect_at_its_place() -> None:
    law = Truth("law", "named", (COULOMB,))
    found = judged(law, named(("motor_coulomb", "elbow")))
    assert found["right"] and found["first"] and found["in_set"] and not found["extra"] and not found["misnamed"]
    (size,) = found["sizes"]
    assert size["error"] == size["error_work"] == pytest.approx(0.0)
    assert size["covered"] and size["covered_work"] and size["exact"]
    assert not judged(law, named(("motor_coulomb", "elbow"), value=0.0315))["sizes"][0]["covered"]
    for pair in (("motor_coulomb", "shoulder"), ("motor_viscous", "elbow"), ("link_coulomb", "elbow")):
        found = judged(law, named(pair))
        assert not found["right"] and not found["first"] and found["misnamed"] and found["extra"] == 1
        assert found["in_set"] is False
    for answer in ("unknown", "nothing missing", "refused", "values differ"):
        found = judged(law, {"answer": answer, "sentence": ""})
        assert not found["right"] and not found["first"] and found["in_set"] is None and not found["misnamed"]


def test_a_further_name_is_extra() -> None:
    law = Truth("law", "named", (COULOMB,))
    found = judged(law, named(("motor_coulomb", "elbow"), ("motor_viscous", "shoulder")))
    assert found["first"] and not found["right"] and found["extra"] == 1
    found = judged(law, named(("motor_viscous", "shoulder"), ("motor_coulomb", "elbow")))
    assert not found["first"]


def test_part_named_counts_only_for_another_form() -> None:
    part = named(("motor_coulomb", "elbow"), answer="part named")
    assert not judged(Truth("law", "named", (COULOMB,)), part)["right"]
    assert judged(Truth("law", "named", (OTHER,)), part)["right"]
    family = named(("motor_stribeck", "elbow"), answer="part named")
    assert judged(Truth("law", "named", (OTHER,)), family)["first"]
    assert not judged(Truth("law", "named", (OTHER,)), named(("motor_stribeck", "elbow")))["right"]
    assert not judged(Truth("law", "named", (OTHER,)), named(("torque_lag", "elbow"), answer="part named"))["right"]


def test_a_set_holds_the_truth_but_is_no_name() -> None:
    law = Truth("law", "named", (COULOMB,))
    found = judged(law, named(("link_coulomb", "elbow"), answer="cannot tell", instead=("motor_coulomb2",)))
    assert found["in_set"] and found["set_size"] == 2.0 and not found["first"] and not found["right"]
    found = judged(law, named(("link_coulomb", "elbow"), answer="cannot tell", instead=("motor_coulomb1",)))
    assert found["in_set"] is False


def test_motor_and_link_of_a_rigid_joint_are_one() -> None:
    rigid = True_("motor_coulomb", "elbow", 0.03, True, (), True, 6.0)
    law = Truth("law", "named", (rigid,))
    found = judged(law, named(("link_coulomb", "elbow"), value=0.18))
    assert found["right"] and found["sizes"][0]["error"] == pytest.approx(0.0)
    found = judged(law, named(("motor_coulomb", "elbow"), answer="cannot tell", instead=("link_coulomb2",)))
    assert found["right"]


def test_outside_the_catalogue() -> None:
    for group in ("outside", "without"):
        law = Truth(group, "unknown", (OUTSIDE,))
        found = judged(law, {"answer": "unknown"})
        assert found["right"] and not found["misnamed"]
        found = judged(law, named(("motor_viscous", "elbow"), answer="part named"))
        assert found["right"] and not found["misnamed"]
        found = judged(law, named(("motor_viscous", "shoulder"), answer="part named"))
        assert not found["right"] and found["misnamed"]
        # the family alone is no name of a law that no catalogue has
        found = judged(law, named(("motor_viscous", "elbow")))
        assert not found["right"] and found["misnamed"]
        for answer in ("nothing missing", "refused", "values differ"):
            found = judged(law, {"answer": answer})
            assert not found["right"] and not found["misnamed"]


def test_pairs_need_both() -> None:
    lag = True_("torque_lag", "shoulder", 1e-3, False, (), False, 50.0)
    pair = Truth("pair", "named", (COULOMB, lag))
    both = named(("motor_coulomb", "elbow"), ("torque_lag", "shoulder"))
    assert judged(pair, both)["right"] and judged(pair, both)["in_set"]
    one = judged(pair, named(("motor_coulomb", "elbow")))
    assert not one["right"] and one["first"] and one["in_set"] is False and not one["extra"]


def test_what_the_torque_sensors_have_may_be_named_beside() -> None:
    beside = (("torque_gain", "elbow", (-0.018,)), ("torque_offset", "elbow", ()))
    null = Truth("null", "nothing missing", beside=beside)
    gain = named(("torque_gain", "elbow"), value=-0.0179)
    assert judged(null, gain)["right"] and not judged(null, gain)["false"] and judged(null, gain)["extra"] == 0
    assert judged(null, named(("torque_gain", "elbow"), value=0.018))["false"]
    assert judged(null, named(("torque_gain", "shoulder"), value=-0.018))["false"]
    assert judged(Truth("null", "nothing missing"), gain)["false"]
    law = Truth("law", "named", (COULOMB,), beside=beside)
    both = named(("torque_offset", "elbow"), ("motor_coulomb", "elbow"))
    assert judged(law, both)["first"] and judged(law, both)["right"]
    assert not judged(law, gain)["right"] and judged(law, gain)["in_set"] is None


def test_values() -> None:
    true = Truth("values", "values differ", (), ("k1", "Im2"))
    values = [{"name": "k1", "differs": True}, {"name": "Im2", "differs": True}, {"name": "k2", "differs": False}]
    assert judged(true, {"answer": "values differ", "values": values})["right"]
    assert not judged(true, {"answer": "values differ", "values": values[:1]})["right"]
    assert judged(true, named(("motor_coulomb", "elbow")))["false"]


def test_a_payload_that_comes() -> None:
    true = Truth("change", "changed")
    assert judged(true, {"answer": "changed"})["right"]
    assert judged(true, named(("body_change", None)))["right"]
    assert judged(true, named(("motor_coulomb", "elbow")))["false"]
    assert not judged(true, {"answer": "unknown"})["right"]


def test_the_multiple_is_that_of_the_limit_which_the_verdict_states() -> None:
    law = Truth("law", "named", (COULOMB,))
    verdict = {"candidates": [{"name": "motor_coulomb2", "limit": 0.01}, {"name": "motor_coulomb1", "limit": 0.001}]}
    assert multiple(law, verdict, JOINTS) == pytest.approx(3.0)
    assert multiple(law, {"candidates": []}, JOINTS) is None


def line(cell: str, group: str, true: Truth, verdict: dict[str, Any], product: str = "p", draw: int = 0, **more: Any):  # type: ignore[no-untyped-def]
    return {
        "cell": cell,
        "draw": draw,
        "arm": cell.split("/", maxsplit=1)[0],
        "group": group,
        "nominal": 30.0,
        "dirty": False,
        "product": product,
        "commit": "c",
        "truth": [],
        "answer": verdict["answer"],
        "sentence": "",
        "findings": [[f["effect"], f["joint"]] for f in verdict.get("findings", [])],
        "multiple": None,
        "limits": {},
        "gap": None,
        "score": judged(true, verdict),
        **more,
    }


def test_exact_limits() -> None:
    for events, runs in ((0, 150), (3, 150), (140, 150)):
        both = binomtest(events, runs).proportion_ci(confidence_level=0.9, method="exact")
        assert ledger.upper(events, runs) == pytest.approx(both.high, rel=1e-9)
        assert ledger.lower(events, runs) == pytest.approx(both.low, rel=1e-9)
    assert (ledger.upper(5, 5), ledger.lower(0, 5)) == (1.0, 0.0)


def test_figures_and_table_of_a_ledger(tmp_path: Path) -> None:
    null, law, outside = Truth("null", ""), Truth("law", "named", (COULOMB,)), Truth("outside", "unknown", (OUTSIDE,))
    right, wrong = named(("motor_coulomb", "elbow")), named(("link_coulomb", "elbow"))
    gap = {"as_delivered": 90.0, "refit": 20.0, "closed": 1.2, "floor": 1.0}
    path = tmp_path / "ledger.jsonl"
    cell = "planar/motor_coulomb/elbow/x"
    for one in (
        line("planar/null", "null", null, right, "old"),
        line("planar/null", "null", null, {"answer": "nothing missing"}, limits={"motor_coulomb2": 0.002}),
        line("planar/null", "null", null, right, draw=1, limits={"motor_coulomb2": 0.004}),
        line(f"{cell}30", "law", law, right, gap=gap, cpu_s=9.0, plant_cpu_s=3.0),
        line(f"{cell}30", "law", law, {"answer": "refused"}, draw=1),
        line(f"{cell}30", "law", law, wrong, draw=2, overlap={"link_coulomb elbow": 0.99}),
        line(f"{cell}30", "law", law, wrong, draw=3, overlap={"link_coulomb elbow": 0.5}),
        line(f"{cell}3", "law", law, {"answer": "unknown"}, nominal=3.0, multiple=2.9),
        line("planar/outside/drag/elbow", "outside", outside, right, "old"),
    ):
        ledger.append(one, path)
    lines = ledger.read(path)
    assert len(lines) == 9
    of = ledger.newest(lines)
    assert [x["product"] for x in of if (x["cell"], x["draw"]) == ("planar/null", 0)] == ["p"]
    found = {m.name: m for m in ledger.measures(of)}
    assert (found["nulls with any false name"].value, found["nulls with any false name"].runs) == (0.5, 2)
    earlier = {m.name: m for m in ledger.measures(ledger.first_scores(lines))}
    assert earlier["nulls with any false name"].value == 1.0
    first = found["right effect and place first, from 3 detection limits on"]
    assert (first.value, first.runs, first.met) == (0.25, 4, False)  # the refusal counts, the small one does not
    assert found["outside the catalogue: misnamed"].value == 1.0
    assert found["extra names a run"].value == pytest.approx(3.0 / 7.0)
    assert found["error of the size, median"].met
    assert found["held-out error over its floor, median"].value == pytest.approx(1.2)
    assert ledger.typical_limits(lines) == {"planar/clean": {"motor_coulomb2": 0.003}}
    text = ledger.markdown(lines)
    assert "| planar | motor_coulomb | 0/1 | – | 1/4 |" in text
    assert "8 runs of 4 cells with 2 versions of the product: 7 of p (commit c), 1 of old (commit c)" in text
    assert "1 of these runs were scored before, with an earlier version: 1 were not right then" in text
    causes = {(x[0], x[1]): x[-1] for x in ledger.missed(of)}
    assert causes == {
        ("planar/null", "1"): "ours",
        (f"{cell}30", "1"): "ours",
        (f"{cell}30", "2"): "identical on this motion: overlap of link_coulomb elbow 0.990",
        (f"{cell}30", "3"): "ours; overlap of link_coulomb elbow 0.500",
        (f"{cell}3", "0"): "size below three stated limits",
        ("planar/outside/drag/elbow", "0"): "ours",
    }
    assert ledger.costs(of) == [("planar", "1", "3.0", "9.0 (9)", "0.2")]


def test_the_overlap_is_that_of_what_was_named_with_the_true_column() -> None:
    law = Truth("law", "named", (COULOMB,))
    listed = [
        {"name": "motor_coulomb2", "completeness": [1.0, 0.96]},
        {"name": "link_coulomb2", "completeness": [0.25, 0.24]},
        {"name": "motor_stribeck2@0.04", "completeness": [0.5, 0.3]},
        {"name": "motor_stribeck2@0.08", "completeness": [0.96, 0.97]},
    ]
    verdict = {**named(("link_coulomb", "elbow"), instead=("motor_stribeck2@0.04",)), "candidates": listed}
    found = overlaps(law, verdict, JOINTS)
    assert found == pytest.approx({"link_coulomb elbow": 0.5, "motor_stribeck elbow": 1.0})
    assert overlaps(law, {**named(("motor_coulomb", "elbow")), "candidates": listed}, JOINTS) == {}
    assert overlaps(law, {**verdict, "candidates": listed[1:]}, JOINTS) == {}
    ground = [{"name": c["name"], "explained": c["completeness"][1]} for c in listed]
    elsewhere = [{"name": "motor_coulomb1", "explained": 0.96}, *ground[:1]]
    assert overlaps(law, {**verdict, "candidates": ground}, JOINTS)["link_coulomb elbow"] == pytest.approx(0.5)
    assert overlaps(law, {**named(("motor_coulomb", "shoulder")), "candidates": elsewhere}, JOINTS) == {}


def test_a_ledger_is_only_ever_added_to() -> None:
    """Every line of the committed ledger can be read, and has what the table needs."""
    for one in ledger.read():
        assert {"cell", "draw", "seed", "product", "commit", "generator", "answer", "score", "truth"} <= set(one)
        json.dumps(one)
