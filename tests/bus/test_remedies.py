# SPDX-License-Identifier: MIT
"""Every key and command that `check-arm` and `estimate` propose is carried out on a run with its fault."""

from __future__ import annotations

import ast
import gzip
import inspect
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
import typer
from arm_support import exact_torques
from audit_support import (
    Fault,
    both,
    exchanged,
    inverted,
    late,
    noisy,
    over_the_bus,
    rounded,
    scaled,
    shifted,
    swapped,
    with_column,
)
from cli_support import run
from panda_support import panda, recorded
from runs_support import trajectory_of

from conftest import EXAMPLE, ROOT, need
from zygos.accuracy.cases import all_cases, chosen
from zygos.arm import Arm, Smoother, load_arm, save_arm
from zygos.audit import Audit, audit, remedies
from zygos.audit.delays import Group
from zygos.audit.delays import shifted as taken_later
from zygos.audit.remedies import Setting
from zygos.audit.traffic import traffic_of
from zygos.audit.units import FACTORS
from zygos.can.run import Run, load_run
from zygos.cli import COMMANDS, FORMER, load
from zygos.cli.options import _usage
from zygos.estimation import remedies as of_estimates
from zygos.files.tables import write_columns
from zygos.ground import estimate as of_ground
from zygos.model.model import load_model
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import load_scenario
from zygos.telemetry.map import UNITS

Document = tomlkit.TOMLDocument
NAMES = {"q": "link", "theta": "motor", "tau": "torque"}


# --------------------------------------------------------------------------------------------- carrying out keys


def table_of(document: Document, path: Sequence[str]) -> Any:
    """The table of a setting: ("joint", name, sensor) is that of the joint of this name."""
    found: Any = document
    if path and path[0] == "joint":
        found = next(joint for joint in document["joint"] if joint["name"] == path[1])  # type: ignore[union-attr]
        path = path[2:]
    for key in path:
        found = found.setdefault(key, tomlkit.table())
    return found


def carry_out(settings: Sequence[Setting], arm: Document, mapping: Document) -> None:
    """Write keys into the two files, as a person does who reads the remedy."""
    before = tomlkit.parse(tomlkit.dumps(mapping))
    for one in settings:
        table = table_of(arm if one.file == "arm" else mapping, one.table)
        if one.key == "source":
            table["column"] = table_of(before, str(one.value).split("."))["column"]
            continue
        if one.key in ("counts", "quantum_rad"):
            table.pop({"counts": "quantum_rad", "quantum_rad": "counts"}[one.key], None)
        table[one.key] = list(one.value) if isinstance(one.value, tuple) else one.value


def map_of(arm: Arm) -> Document:
    """A map of a table that has the readings of cycles as they are."""
    document = tomlkit.document()
    document["time"] = {"source": "column", "column": "t", "unit": "s", "interpolation": "linear"}
    joints = tomlkit.aot()
    for i, joint in enumerate(arm.joints):
        entry = tomlkit.table()
        entry["name"] = joint.name
        for kind, name in NAMES.items():
            if kind != "q" or joint.flexible:
                own = {"column": f"{kind}{i}", "unit": "Nm" if kind == "tau" else "rad"}
                entry[name] = own | ({"side": "output"} if kind == "theta" else {})
        joints.append(entry)
    document["joint"] = joints
    if arm.free:
        document["gyro"] = {axis: {"column": f"omega{i}", "unit": "rad/s"} for i, axis in enumerate("xyz")}
    return document


def converted(folder: Path, arm: Document, mapping: Document, cycles: Cycles, period_s: float) -> tuple[Arm, Cycles]:
    """The run that `zygos convert` makes of a table with these readings."""
    folder.mkdir()
    fields = ("q", "theta", "tau", "omega")
    columns = {f"{kind}{i}": column for kind in fields for i, column in enumerate(getattr(cycles, kind).T)}
    write_columns(folder / "raw.npz", {"t": period_s * (cycles.sync - cycles.sync[0]).astype(float), **columns})
    (folder / "map.toml").write_text(tomlkit.dumps(mapping))
    (folder / "arm.toml").write_text(tomlkit.dumps(arm))
    out = folder / "out" / "run.npz"
    out.parent.mkdir()
    assert run("convert", folder / "raw.npz", "--map", folder / "map.toml", "-o", out) in (0, 3)
    found = load_run(out)
    return found.arm, found.cycles


def document_of(folder: Path, arm: Arm) -> Document:
    save_arm(arm, folder / "own.toml")
    return tomlkit.parse((folder / "own.toml").read_text())


def checked(folder: Path, arm: Document, mapping: Document | None, cycles: Cycles, period_s: float) -> Audit:
    """`check-arm` of a run: of these cycles, or of what a map makes of them."""
    if mapping is not None:
        return audit(*converted(folder, arm, mapping, cycles, period_s))
    folder.mkdir()
    (folder / "arm.toml").write_text(tomlkit.dumps(arm))
    return audit(load_arm(folder / "arm.toml"), cycles)


# --------------------------------------------------------------------------------------------- faults


def older(kind: Any, columns: Sequence[int], periods: float) -> Fault:
    """Readings that are so many periods older than their stamps."""

    def delay(cycles: Cycles) -> Cycles:
        inner = slice(10, -10)
        moved = taken_later(cycles, Group(kind, tuple(columns)), -periods)
        return Cycles(*(getattr(moved, name)[inner] for name in Cycles.__dataclass_fields__))

    return delay


def wrapped(kind: str, i: int, low: float) -> Fault:
    return lambda c: with_column(c, kind, i, (getattr(c, kind)[:, i] - low) % (2 * np.pi) + low)


@dataclass(frozen=True)
class Case:
    """A fault, and the function that proposes what removes it."""

    remedy: str
    fault: Fault
    finding: str
    """What the first finding begins with, behind its signal."""
    mapped: bool = False
    """Whether keys of a map are proposed."""


nothing: Fault = both()
DEGREES = 180.0 / np.pi
CASES = [
    Case("steps", rounded("q", 0, 2 * np.pi / 1024), "moves in steps of 2π/1024"),
    Case("noisy_angle", noisy("theta", 1, 0.01), "noisier than declared"),
    Case("noisy_gyro", noisy("omega", 0, 1e-5), "noisier than declared"),
    Case("inverted", inverted("q", 0), "inverted"),
    Case("inverted", inverted("tau", 1), "inverted", mapped=True),
    Case("swapped", swapped("tau", 0, 1), "swapped with elbow torque", mapped=True),
    Case("exchanged", exchanged(1), "swapped with elbow motor angle", mapped=True),
    Case("unit", scaled("theta", 0, DEGREES), "in deg, not in rad", mapped=True),
    Case("unit", both(*(scaled(k, i, DEGREES) for k in ("q", "theta") for i in (0, 1))), "in deg, not in rad",
         mapped=True),
    Case("unit", both(*(scaled("omega", i, DEGREES) for i in range(3))), "in deg/s, not in rad/s", mapped=True),
    Case("unit", both(*(scaled(k, i, DEGREES) for k, n in (("q", 2), ("theta", 2), ("omega", 3)) for i in range(n))),
         "in deg", mapped=True),
    Case("unit", scaled("q", 0, 1 / 0.003), "in counts, not in rad", mapped=True),
    Case("unit", scaled("tau", 0, 1e3), "in mNm, not in Nm", mapped=True),
    Case("scaled", scaled("theta", 1, 50.0), "scaled by 50", mapped=True),
    Case("wraps", wrapped("q", 1, -np.pi + 0.3), "wraps", mapped=True),
    Case("zero", shifted("q", 0, 0.03), "zero off by"),
    Case("torque_scale", scaled("tau", 1, 3.0), "scaled by 2.99"),
    Case("delay", older("omega", range(3), 1.0), "late by", mapped=True),
    Case("delay", older("tau", (0, 1), 2.0), "late by", mapped=True),
    Case("delay", older("tau", (0, 1), -2.0), "early by", mapped=True),
    Case("delay", older("omega", range(3), -0.6), "early by"),
    Case("delay", older("q", (0, 1), 1.4), "late by", mapped=True),
    Case("delay", older("theta", (0,), 2.0), "late by", mapped=True),
    Case("torque_law", older("tau", (0, 1), 1.0), "not applied_from_sync"),
    Case("mount", swapped("omega", 1, 2), "swapped with gyro z"),
    Case("mount", inverted("omega", 2), "inverted"),
    Case("turned_joint", both(inverted("q", 1), inverted("theta", 1), inverted("tau", 1)),
         "inverted, as all signals of the joint", mapped=True),
]  # fmt: skip
ELSEWHERE = {"period", "noisy_torque", "skew", "swapped_joints", "smoother"}
"""Those that a table of the example cannot show, and that have a test of their own below."""


def proposers() -> set[str]:
    """The functions that make the remedies with keys."""
    return {
        name
        for name, one in inspect.getmembers(remedies, inspect.isfunction)
        if one.__module__ == remedies.__name__ and one.__annotations__.get("return") == "Remedy" and name != "by_hand"
    }


def test_every_remedy_with_keys_is_carried_out() -> None:
    assert proposers() == {case.remedy for case in CASES} | ELSEWHERE


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The names of the functions that proposed something."""
    names = set[str]()

    def noted(name: str, own: Callable[..., Any]) -> Callable[..., Any]:
        def propose(*arguments: Any, **named: Any) -> Any:
            names.add(name)
            return own(*arguments, **named)

        return propose

    for name in proposers():
        monkeypatch.setattr(remedies, name, noted(name, getattr(remedies, name)))
    return names


def settings_of(found: Audit) -> list[Setting]:
    return list(dict.fromkeys(one for finding in found.findings for one in finding.settings))


def named(found: Audit) -> list[str]:
    return [f"{one.signal} {one.fault}" for one in found.findings]


@pytest.mark.slow(but=["torque_law *"])
@pytest.mark.parametrize("case", CASES, ids=[f"{case.remedy} {case.finding}" for case in CASES])
def test_the_keys_remove_the_finding(
    case: Case, noisy: Trajectory, arm: Arm, tmp_path: Path, called: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    cycles = case.fault(noisy.cycles(0))
    own, mapping = document_of(tmp_path, arm), map_of(arm) if case.mapped else None
    found = checked(tmp_path / "before", own, None, cycles, arm.period_s)
    assert found.findings and all(one.fault.startswith(case.finding.split(" ")[0]) for one in found.findings), found
    assert any(one.fault.startswith(case.finding) for one in found.findings), named(found)
    assert case.remedy in called
    settings = settings_of(found)
    assert settings and (case.mapped or {one.file for one in settings} == {"arm"})
    for finding in found.findings:
        assert not finding.settings or str(finding.settings[0]) in finding.remedy or case.remedy in (
            "swapped", "exchanged", "turned_joint", "wraps",
        )  # fmt: skip
    carry_out(settings, own, mapping if mapping is not None else tomlkit.document())
    after = checked(tmp_path / "after", own, mapping, cycles, arm.period_s)
    assert after.findings == (), named(after)
    assert after.ok


@pytest.mark.slow
def test_the_period_and_the_nodes_on_the_bus(noisy: Trajectory, arm: Arm, tmp_path: Path, called: set[str]) -> None:
    frames = encode(arm, noisy.cycles(0))
    first, second = arm.joints
    wrong = replace(arm, period_s=0.04, joints=(replace(first, node=second.node), replace(second, node=first.node)))
    for remedy, told, begins in (
        ("period", replace(wrong, joints=arm.joints), "SYNC every 50 ms"),
        ("swapped_joints", replace(wrong, period_s=arm.period_s), "swapped with"),
    ):
        document = document_of(tmp_path, told)
        for again in (False, True):
            (tmp_path / "told.toml").write_text(tomlkit.dumps(document))
            known = load_arm(tmp_path / "told.toml")
            found = audit(known, Run(known, frames).cycles, traffic_of(known, frames))
            if not again:
                assert remedy in called and begins in " ".join(named(found))
                wanted = [one for one in settings_of(found) if one.key in ("period_s", "node")]
                carry_out(wanted, document, tomlkit.document())
        assert found.findings == (), named(found)


@pytest.mark.slow
def test_the_noise_of_a_torque(tmp_path: Path, called: set[str]) -> None:
    cycles = recorded(panda(3), 6, noise=0.01).cycles
    arm = panda(3)
    told = replace(arm, joints=tuple(replace(joint, torque_sigma=1e-5) for joint in arm.joints))
    document = document_of(tmp_path, told)
    found = checked(tmp_path / "before", document, None, cycles, arm.period_s)
    assert all(one.fault.startswith("noisier than declared") for one in found.findings) and "noisy_torque" in called
    carry_out(settings_of(found), document, tomlkit.document())
    assert checked(tmp_path / "after", document, None, cycles, arm.period_s).ok


@pytest.mark.slow
def test_a_latch(arm: Arm, tmp_path: Path, called: set[str]) -> None:
    true = late(arm, 0, "motor_encoder", 20_000)
    model, scenario = load_model(EXAMPLE / "model.toml"), load_scenario(EXAMPLE / "scenario.toml")
    cycles = over_the_bus(true, trajectory_of(true, model, scenario, seeds=range(1), noise=True).cycles(0))
    document = document_of(tmp_path, arm)
    found = checked(tmp_path / "before", document, None, cycles, arm.period_s)
    assert "skewed" in found.findings[0].fault and "skew" in called
    carry_out(settings_of(found), document, tomlkit.document())
    assert checked(tmp_path / "after", document, None, cycles, arm.period_s).findings == ()


def test_a_latch_that_no_cycle_has_room_for_is_a_delay_of_the_other_encoder(arm: Arm) -> None:
    for skew_s, table in ((0.06, "link"), (-0.06, "motor")):
        (setting,) = remedies.skew(arm, 0, skew_s).settings
        assert setting == Setting("map", ("joint", "shoulder", table), "delay_s", 0.06)
    (setting,) = remedies.skew(arm, 0, 0.02).settings
    assert (setting.file, setting.key, setting.value) == ("arm", "latch_us", 20_000)


@pytest.mark.slow
def test_a_smoother(tmp_path: Path, called: set[str]) -> None:
    (case,) = chosen(all_cases(ROOT / "examples"), ["fixed"])
    arm = replace(exact_torques(case.arm), smoother=Smoother(21, 4, 10))
    precision = {"rtol": 1e-9, "atol": 1e-11}
    trajectory = trajectory_of(
        case.plant, case.model, case.scenario, seeds=[0], noise=True, duration_s=15.0, **precision
    )
    cycles, document = over_the_bus(arm, trajectory.cycles(0)), document_of(tmp_path, arm)
    found = checked(tmp_path / "before", document, None, cycles, arm.period_s)
    assert "smoother" in called
    carry_out(settings_of(found), document, tomlkit.document())
    assert checked(tmp_path / "after", document, None, cycles, arm.period_s).findings == ()


@pytest.mark.slow
def test_the_torque_law_of_an_arm_on_the_ground(tmp_path: Path, called: set[str]) -> None:
    """Torques half a period older than samples would be are those of the cycle before."""
    cycles = older("tau", range(3), 0.5)(recorded(panda(3), 0, noise=0.0).cycles)
    arm = replace(panda(3), joints=tuple(replace(joint, torque_sigma=1.0) for joint in panda(3).joints))
    document = document_of(tmp_path, arm)
    found = checked(tmp_path / "before", document, None, cycles, arm.period_s)
    assert named(found) == ["torques not sampled"] and "torque_law" in called
    carry_out(settings_of(found), document, tomlkit.document())
    assert document["torque_law"] == "applied_previous_cycle"
    assert checked(tmp_path / "after", document, None, cycles, arm.period_s).findings == ()


@pytest.mark.slow
def test_means_have_one_torque_law(tmp_path: Path) -> None:
    """`zygos convert` declares torque_averaged, which the arm file takes with one law only; torques that are late are
    a delay then, and no other law."""
    cycles = recorded(panda(3), 0, noise=0.01).cycles
    arm = replace(panda(3), torque_averaged=True)
    found = audit(arm, older("tau", range(3), 5.0)(cycles))
    assert named(found)[0].startswith("torques late by 19.") or named(found)[0].startswith("torques late by 20.")
    assert {one.key for one in settings_of(found)} == {"delay_s"}


# --------------------------------------------------------------------------------------------- what is no fault


def test_the_units_are_those_of_the_map() -> None:
    for quantity, units in FACTORS.items():
        for unit, factor in units.items():
            known = UNITS["torque" if quantity == "current" else quantity]  # type: ignore[index]
            assert unit in known and (np.isnan(known[unit]) or known[unit] == pytest.approx(factor, rel=1e-12))


# --------------------------------------------------------------------------------------------- estimate


def texts_of(module: Any) -> str:
    """What the messages of a module say: its strings, without its docstrings."""
    tree = ast.parse(inspect.getsource(module))
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return " ".join(
        str(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
    )


MODULES = sorted((ROOT / "harness" / "zygos").rglob("*.py"))


def options_of(command: str, *, required: bool = False) -> set[str]:
    """The options of a command, or those without which it does nothing."""
    params = [one for one in load(command).params if one.param_type_name == "option"]
    return {option for one in params if one.required or not required for option in one.opts} - {"--help"}


def test_commands_and_options_that_messages_name_exist() -> None:
    """Of all messages. A command with the files that it takes names the options without which it is refused, too."""
    commands = set[str]()
    for path in MODULES:
        text = path.read_text()
        if path.parent.name != "cli" and "`zygos " not in text:
            continue
        tree = ast.parse(text)
        docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) in docs or not isinstance(node, ast.JoinedStr | ast.Constant):
                continue
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            said = "".join(str(one.value) if isinstance(one, ast.Constant) else "X" for one in parts)
            for command, rest in re.findall(r"`zygos ([a-z-]+)([^`]*)`", said):
                commands.add(command)
                assert command in COMMANDS | FORMER, (path, said)
                options = set(re.findall(r"(?<=\s)--?[a-z][a-z-]*", rest))
                assert options <= options_of(command), (path, said)
                wanted = options_of(command, required=True)
                assert not re.search(r" [A-Z]", rest) or not wanted or options & wanted, (path, said)
            if path.parent.name == "cli" and "remedy: " in said and (own := path.stem.replace("_", "-")) in COMMANDS:
                named = {own, *re.findall(r"`zygos ([a-z-]+)", said)} & set(COMMANDS | FORMER)
                options = set(re.findall(r"(?<=[\s(])--[a-z][a-z-]*", said.split("remedy: ", 1)[1]))
                assert options <= set().union(*map(options_of, named)), (path, said)
    assert {"check-arm", "convert", "estimate", "explain", "fit", "plan", "predict"} <= commands


@pytest.mark.parametrize("command", [name for name in COMMANDS if "--arm" in options_of(name)])
def test_the_usage_of_a_command_is_complete(command: str) -> None:
    """What is said where files are swapped names each option without which the command is refused."""
    found = load(command)
    said = _usage(typer.Context(found, info_name=command))
    for one in found.params:
        assert not one.required or any(option in said for option in one.opts) or str(one.metavar) in said


KEYS = re.compile(r"\b(counts|quantum_rad|rate_sigma|torque_gain_sigma|gear_ratio|cutoff_hz|points|memory_min|max_s|"
                  r"period_s|torque_sigma|gravity|zero_rad|torque_law)\b")  # fmt: skip


def test_keys_that_messages_of_estimates_name_are_keys_of_the_arm_file() -> None:
    known = (ROOT / "docs" / "reference" / "arm.md").read_text()
    named_keys = set(KEYS.findall(texts_of(of_estimates) + texts_of(of_ground)))
    assert {"counts", "quantum_rad", "cutoff_hz", "memory_min", "max_s"} <= named_keys
    assert all(f"`{key}`" in known or f".{key}`" in known for key in named_keys)


# --------------------------------------------------------------------------------------------- from end to end


@pytest.mark.slow
def test_torques_that_a_recording_has_20_ms_late(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The delay is measured and proposed as a key of the map, never as another torque law; with it the estimate has the
    true values: an inertia of 0.85 kg m^2, viscous friction of 0.008 N m s/rad and Coulomb friction of 0.016 N m."""
    cases = ROOT.parent / "shared" / "cases"
    table = cases / "torque_20ms_late.csv.gz"
    need(table.is_file(), f"the recording {table.name}")
    (tmp_path / "late.csv").write_bytes(gzip.decompress(table.read_bytes()))
    arm = (cases / "torque_late_arm.toml").read_text().replace('"planar-symmetric"', '"spatial"')
    (tmp_path / "arm.toml").write_text(arm)
    mapping = tomlkit.parse((cases / "torque_late_map.toml").read_text())
    for name in ("before", "after"):
        (tmp_path / "map.toml").write_text(tomlkit.dumps(mapping))
        out = tmp_path / name / "run.npz"
        out.parent.mkdir()
        assert run("convert", tmp_path / "late.csv", "--map", tmp_path / "map.toml", "-o", out) == 0
        assert f"next: zygos check-arm {out} · " in capsys.readouterr().out.replace("\n", "")
        found = load_run(out)
        checked_run = audit(found.arm, found.cycles)
        if name == "before":
            assert found.arm.torque_averaged
            (late_torques,) = checked_run.findings
            (setting,) = late_torques.settings
            assert late_torques.signal == "torques" and setting.key == "delay_s"
            assert setting.value == pytest.approx(0.020, abs=2e-4)
            carry_out(checked_run.findings[0].settings, tomlkit.document(), mapping)
    assert checked_run.findings == () and run("check-arm", out) == 0
    assert run("estimate", out, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    values = {one["name"]: one["value"] for one in json.loads((tmp_path / "m.json").read_text())["parameters"]}
    assert values["Ixx1"] == pytest.approx(0.85, rel=3e-4)
    assert values["motor_viscous1"] == pytest.approx(0.008, rel=5e-3)
    assert values["motor_coulomb1"] == pytest.approx(0.016, rel=5e-3)
