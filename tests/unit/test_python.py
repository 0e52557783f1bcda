# SPDX-License-Identifier: MIT
"""`import zygos`: the list of names, arrays in and out, refusals, the examples of docs/python.md, and the notebook."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

import zygos
from conftest import EXAMPLE, ROOT, need
from zygos.report.values import Valued

PAGE = (ROOT / "docs" / "python.md").read_text()


@pytest.fixture(scope="module")
def simulation() -> zygos.Simulation:
    arm, model = zygos.load_arm(EXAMPLE / "arm.toml"), zygos.load_model(EXAMPLE / "model.toml")
    return zygos.simulate_with_truth(arm, model, scenario(), seed=3, duration_s=20.0)


@pytest.fixture(scope="module")
def run(simulation: zygos.Simulation) -> zygos.Run:
    return simulation.run


# ------------------------------------------------------------------------------------------ the list of names


def test_every_name_is_there_and_documented() -> None:
    assert dir(zygos) == sorted(zygos.__all__)
    for name in set(zygos.__all__) - {"__version__"}:
        assert getattr(zygos, name).__doc__, name


def test_importing_loads_no_library() -> None:
    """The command line imports the package as well, and lists its commands at once."""
    loaded = "(name for name in sys.modules if name.split('.')[0] in ('numpy', 'scipy', 'zygos'))"
    code = f"import sys, zygos; dir(zygos); print(*{loaded})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["zygos"]


def test_a_name_that_does_not_exist() -> None:
    with pytest.raises(AttributeError, match="no attribute 'estimte'"):
        _ = zygos.estimte  # type: ignore[attr-defined]


@pytest.mark.slow
def test_users_of_mypy_see_types(tmp_path: Path) -> None:
    """Strictly: a wrong argument and a misspelled name are errors, and what is right is none."""
    right = 'import zygos\narm = zygos.load_arm("arm.toml")\nrun = zygos.load_run("run.blf", arm)\n'
    right += "values: float = float(zygos.estimate(run).value[0])\nprint(zygos.__version__, values)\n"
    (tmp_path / "right.py").write_text(right)
    (tmp_path / "wrong.py").write_text(right + "zygos.estimate(arm)\nzygos.estimte(run)\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", "--cache-dir", str(tmp_path / "c")]
    done = subprocess.run(
        [*command, "--follow-imports", "silent", "right.py", "wrong.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False, env={"MYPYPATH": str(ROOT / "harness")},
    )  # fmt: skip
    need("No module named mypy" not in done.stderr, "mypy")
    said = [(line.partition(":")[0], line.rpartition("[")[2]) for line in done.stdout.splitlines() if "[" in line]
    assert said == [("wrong.py", "arg-type]"), ("wrong.py", "attr-defined]")]


# ------------------------------------------------------------------------------------------ values


@dataclass(frozen=True)
class Few(Valued):
    """An answer of two parameters, of which one has no value."""

    names: tuple[str, ...] = ("k1", "<b1>")
    units: tuple[str, ...] = ("Nm/rad", "Nms/rad")
    value: np.ndarray = field(default_factory=lambda: np.array([1000.0, np.nan]))
    sigma: np.ndarray = field(default_factory=lambda: np.array([0.5, np.nan]))
    half95: np.ndarray = field(default_factory=lambda: np.array([1.0, np.nan]))


def test_values_are_there_by_name_as_a_table_and_as_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    few = Few()
    assert (float(few["k1"]), few["k1"].unit, few["k1"].half95) == (1000.0, "Nm/rad", 1.0)
    assert str(few["k1"]).startswith("k1 = 1,000.00 ± 1") and str(few["<b1>"]) == "<b1>: no value"
    with pytest.raises(KeyError, match="there is no 'k2'; remedy: one of k1, <b1>"):
        few["k2"]
    assert few.to_frame().rows()[0] == ("k1", "Nm/rad", 1000.0, 0.5, 1.0)
    page = few._repr_html_()
    assert "<th>k1</th><td>1,000.00</td>" in page and "&lt;b1&gt;" in page and "<b1>" not in page
    (drawn,) = few.plot({"k1": 990.0}).containers
    assert drawn.lines[0].get_xdata() == pytest.approx([100.0 * 10.0 / 990.0])


@pytest.mark.parametrize(
    ("library", "call", "extra"), [("polars", "to_frame", "tables"), ("matplotlib.pyplot", "plot", "view")]
)
def test_a_missing_extra_is_named(library: str, call: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(zygos.ZygosError, match=rf"zygos\[{extra}\]"):
        getattr(Few(), call)()


# ------------------------------------------------------------------------------------------ runs and arrays


@pytest.mark.slow
def test_a_run_has_readings_and_no_truth(simulation: zygos.Simulation, run: zygos.Run) -> None:
    n, joints = len(run), run.arm.n
    assert run.t.shape == (n,) and run.q.shape == run.theta.shape == run.tau.shape == (n, joints)
    assert run.omega.shape == (n, 3)
    assert not np.array_equal(run.q, simulation.trajectory.q[0]), "encoders have noise"
    true = {id(simulation), id(simulation.trajectory), id(simulation.model), id(simulation.trajectory.dynamics)}
    assert not any(id(value) in true for value in vars(run).values())
    assert not any(isinstance(value, zygos.Model) for value in vars(run).values())


@pytest.mark.slow(only=[".log", ".blf"])
@pytest.mark.parametrize("suffix", [".blf", ".log", ".npz", ".csv"])
def test_a_saved_run_comes_back(suffix: str, run: zygos.Run, tmp_path: Path) -> None:
    zygos.save_run(run, tmp_path / f"run{suffix}")
    zygos.save_arm(run.arm, tmp_path / "arm.toml")
    again = zygos.load_run(tmp_path / f"run{suffix}")
    assert again.arm == run.arm
    for name in ("t", "q", "theta", "tau", "omega"):
        assert np.array_equal(getattr(again, name), getattr(run, name)), name
    assert (again.frames is None) == (suffix in (".npz", ".csv"))
    zygos.save_run(again, tmp_path / "frames.blf")
    assert np.array_equal(zygos.load_run(tmp_path / "frames.blf").frames, run.frames)  # type: ignore[arg-type]


@pytest.mark.slow
def test_arrays_in_and_out(run: zygos.Run) -> None:
    """The same cycles as arrays give the same estimate; a reading that is changed does not."""
    arrays = {"q": run.q, "theta": run.theta, "tau": run.tau, "omega": run.omega}
    found, again = zygos.estimate(run), zygos.estimate(zygos.make_run(run.arm, **arrays))
    assert np.array_equal(found.value, again.value)
    other = zygos.estimate(zygos.make_run(run.arm, **(arrays | {"tau": 1.01 * run.tau})))
    assert not np.allclose(found.value, other.value, rtol=1e-3)
    half = np.flatnonzero((run.t < 12.0) | (run.t > 14.0))
    gappy = zygos.make_run(run.arm, **{name: values[half] for name, values in arrays.items()}, sync=half)
    assert gappy.t[-1] == run.t[-1] and len(gappy) == len(half)
    assert zygos.estimate(gappy).watch.flight.counts["gaps"] == 1


def test_a_run_is_refined(run: zygos.Run, tmp_path: Path) -> None:
    """A run alone and a list of it are the same; the name is the function's, also behind modules of the package."""
    refined, found = zygos.refine(run), zygos.estimate(run)
    assert zygos.refine is sys.modules["zygos.refinement.refine"].refine_runs
    assert refined.published and not refined.reason and repr(refined).startswith("published\n")
    assert refined.names == found.names and refined.value.shape == found.value.shape
    assert np.all(10.0 * refined.sigma < found.sigma)
    assert refined.runs == (run,)
    assert refined.as_dict()["parameters"][7]["value"] == refined.value[7]
    assert refined.to_model().parameters["k1"].value == refined.value[refined.names.index("k1")]
    zygos.write_report(refined, tmp_path / "refined.html")
    assert "<html" in (tmp_path / "refined.html").read_text()
    doubtful = replace(refined, rules=(replace(refined.rules[0], holds=False, sentence="it is doubtful"),))
    assert repr(doubtful) == "not published: it is doubtful"
    with pytest.raises(zygos.Undecided, match="not published: it is doubtful; remedy: "):
        doubtful.to_model()
    with pytest.raises(zygos.ZygosError, match="there is no run to refine from; remedy: "):
        zygos.refine([])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": np.zeros((5, 3))}, "q has the shape"),
        ({"q": np.zeros((5, 2))}, "theta has the shape"),
        ({"q": 0.0}, "q has the shape"),
        ({"tau": np.zeros(7)}, "tau has the shape"),
        ({"omega": None}, "omega is missing"),
        ({"sync": [3]}, "sync is not"),
        ({"sync": "fall"}, "do not rise"),
        ({"flags": "half"}, "flags is not"),
    ],
)
def test_arrays_that_do_not_fit(change: dict[str, object], said: str, run: zygos.Run) -> None:
    n = len(run)
    special = {"fall": np.arange(n)[::-1], "half": np.full(n, 0.5)}
    change = {key: special.get(value, value) if isinstance(value, str) else value for key, value in change.items()}
    arrays = {"q": run.q, "theta": run.theta, "tau": run.tau, "omega": run.omega, **change}
    with pytest.raises(zygos.ZygosError, match=said) as refusal:
        zygos.make_run(run.arm, **arrays)  # type: ignore[arg-type]
    assert "remedy: " in str(refusal.value)


def test_a_table_that_lacks_cycles_is_no_log(run: zygos.Run, tmp_path: Path) -> None:
    kept = np.flatnonzero(run.t != 10.0)
    part = zygos.make_run(
        run.arm, q=run.q[kept], theta=run.theta[kept], tau=run.tau[kept], omega=run.omega[kept], sync=kept
    )
    with pytest.raises(zygos.ZygosError, match="cycles of this table are missing"):
        zygos.save_run(part, tmp_path / "run.blf")
    zygos.save_run(part, tmp_path / "run.npz")
    with pytest.raises(zygos.ZygosError, match="not a known kind of CAN log"):
        zygos.save_run(part, tmp_path / "run.txt")


def test_a_damaged_log_warns(run: zygos.Run, tmp_path: Path) -> None:
    zygos.save_run(run, tmp_path / "run.blf")
    whole = (tmp_path / "run.blf").read_bytes()
    (tmp_path / "run.blf").write_bytes(whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match=r"run\.blf"):
        read = zygos.load_run(tmp_path / "run.blf", run.arm)
    assert read.damage and 0 < len(read) < len(run)


def test_the_arm_of_a_run_must_be_somewhere(run: zygos.Run, tmp_path: Path) -> None:
    zygos.save_run(run, tmp_path / "run.blf")
    with pytest.raises(zygos.ZygosError, match=r"no such arm file; remedy: give the arm"):
        zygos.load_run(tmp_path / "run.blf")


# ------------------------------------------------------------------------------------------ arms


@pytest.mark.parametrize("name", ["paper", "lively", "spatial", "seven", "gap", "telemetry"])
def test_a_saved_arm_is_the_same_arm(name: str, tmp_path: Path) -> None:
    arm = zygos.load_arm(zygos.example(name) / "arm.toml")
    zygos.save_arm(arm, tmp_path / "arm.toml")
    assert zygos.load_arm(tmp_path / "arm.toml") == arm


def test_a_saved_arm_keeps_what_is_rare(tmp_path: Path) -> None:
    """A fixed base with gravity, a rigid joint, an encoder on the rotor, offsets, delays, memory and compensation."""
    text = """
name = "rare"
base = "fixed"
kinetic = "spatial"
period_s = 0.004
torque_law = "sampled"
torque_at = "rotor"
gravity = [0.1, -9.7, 0.3]
compensation = { every = 3 }
smoother = { points = 11, order = 5 }
arc = { max_s = 20.0, impulse_max_s = 0.0, memory_min = 7.0 }

[[joint]]
name = "stiff"
node = 4
axis = [0, 0.6, 0.8]
frame_rpy = [0.1, 0.2, -0.3]
gear_ratio = 51
motor_encoder = { counts = 4096, side = "rotor", sign = -1, zero_rad = 0.25 }
torque_sigma = 0.02
latch_us = 120
flexible = false

[[joint]]
name = "soft"
node = 7
axis = [1, 0, 0]
gear_ratio = 60
link_encoder = { quantum_rad = 1e-4, zero_sigma_rad = 1e-3, latch_us = 80 }
motor_encoder = { quantum_rad = 7e-4, side = "rotor" }
"""
    (tmp_path / "arm.toml").write_text(text)
    arm = zygos.load_arm(tmp_path / "arm.toml")
    zygos.save_arm(arm, tmp_path / "again.toml")
    again = zygos.load_arm(tmp_path / "again.toml")
    soft = (arm.joints[1].motor_encoder, again.joints[1].motor_encoder)
    assert soft[1].quantum_rad == pytest.approx(soft[0].quantum_rad, rel=4e-16)  # divided by the gear ratio once more
    joints = (again.joints[0], replace(again.joints[1], motor_encoder=soft[0]))
    assert replace(again, joints=joints) == arm


# ------------------------------------------------------------------------------------------ answers


def test_an_estimate_becomes_a_model(simulation: zygos.Simulation, tmp_path: Path) -> None:
    found = zygos.estimate(simulation.run)
    assert (found.validity, found.reason, found.remedy, found.change) == ("valid", "", "", "")
    assert np.all(np.abs(found.value / simulation.true_values - 1.0) < 0.02)
    assert found.covariance.shape == (len(found.names),) * 2
    assert np.allclose(np.sqrt(np.diag(found.covariance)), found.sigma)
    zygos.save_model(found.to_model(), tmp_path / "model.toml")
    again = zygos.load_model(tmp_path / "model.toml").base_parameters(simulation.arm)
    assert [q.value for q in again.values()] == found.value.tolist()
    said = found.as_dict()
    assert said["validity"] == "valid" and [row["name"] for row in said["parameters"]] == list(found.names)
    for name in found.names:
        assert name in repr(found)


def test_effects_of_a_model_and_others_are_learned(simulation: zygos.Simulation) -> None:
    shoulder, elbow = (zygos.effect("motor_viscous", joint) for joint in ("shoulder", "elbow"))
    found = zygos.estimate(simulation.run, model=replace(simulation.model, effects=(shoulder,)), effects=[elbow])
    assert found.names[-2:] == ("motor_viscous1", "motor_viscous2")
    assert [effect.joint for effect in found.to_model().effects] == ["shoulder", "elbow"]


def test_what_the_run_does_not_tell_is_said(simulation: zygos.Simulation) -> None:
    n = 60
    run = simulation.run
    short = zygos.make_run(run.arm, q=run.q[:n], theta=run.theta[:n], tau=run.tau[:n], omega=run.omega[:n])
    found = zygos.estimate(short)
    assert found.validity == "refused" and found.reason and found.remedy
    assert np.isnan(found.value).all()
    with pytest.raises(zygos.Undecided, match=r"^refused: .*; remedy: "):
        found.to_model()
    compared = zygos.check(short)
    assert compared.equal and not compared.solved
    assert "no solution to compare" in compared.unsolved


@pytest.mark.slow
def test_an_arm_that_is_described_wrongly_is_seen(run: zygos.Run) -> None:
    wrong = zygos.make_run(run.arm, q=run.q[:, ::-1], theta=run.theta, tau=run.tau, omega=run.omega)
    assert zygos.check_arm(run).ok
    assert not zygos.check_arm(wrong).ok


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda run, model: zygos.effect("glue", "elbow"), "there is no effect 'glue'; remedy: one of motor_coulomb"),
        (lambda run, model: zygos.effect("motor_coulomb"), "name its joint"),
        (lambda run, model: zygos.effect("angular_momentum", "elbow"), "leave the joint out"),
        (lambda run, model: zygos.estimate(run, effects=[zygos.effect("torque_lag", "wrist")]), "no joint 'wrist'"),
        (lambda run, model: zygos.explain(model, []), "no measured run"),
        (lambda run, model: zygos.explain(model, [run, run]), "run 1 and run 2 are the same recording"),
        (lambda run, model: zygos.explain(model, [table(run), run]), "are the same recording"),
        (lambda run, model: zygos.explain(model, [run, seven()]), "of different arms"),
        (lambda run, model: zygos.explain(model, [seven(), seven()]), "use the same joint names"),
        (lambda run, model: zygos.explain(model, [amps(run)]), "its torques are motor currents"),
        (lambda run, model: zygos.explain(model, [short(run)]), "cannot be cut into 3 parts"),
        (lambda run, model: zygos.explain(model, [short(run)], validate=run), "cannot be cut into 2 parts"),
        (lambda run, model: zygos.predict(model, seven()), "use the same joint names"),
        (lambda run, model: zygos.simulate(run.arm, model, scenario(), engine="ode"), "no engine 'ode'"),
        (lambda run, model: zygos.simulate(run.arm, model, scenario(), seed=-1), "seed -1 is negative"),
    ],
)
def test_refusals(call: object, said: str, simulation: zygos.Simulation) -> None:
    assert callable(call)
    with pytest.raises(zygos.ZygosError, match=re.escape(said)) as refusal:
        call(simulation.run, simulation.model)
    assert "remedy: " in str(refusal.value)


def scenario() -> zygos.Scenario:
    return zygos.load_scenario(EXAMPLE / "scenario.toml")


def table(run: zygos.Run) -> zygos.Run:
    return zygos.make_run(run.arm, q=run.q, theta=run.theta, tau=run.tau, omega=run.omega)


def amps(run: zygos.Run) -> zygos.Run:
    """The same readings of an arm whose torques are motor currents."""
    return replace(run, arm=replace(run.arm, torque_unit="A"), frames=None, table=run.cycles)


def short(run: zygos.Run) -> zygos.Run:
    """The first 8 s."""
    kept = round(8.0 / run.arm.period_s)
    return zygos.make_run(run.arm, q=run.q[:kept], theta=run.theta[:kept], tau=run.tau[:kept], omega=run.omega[:kept])


def seven() -> zygos.Run:
    arm = zygos.load_arm(zygos.example("seven") / "arm.toml")
    still = np.zeros((10, arm.n))
    return zygos.make_run(arm, q=still, theta=still, tau=still, omega=np.zeros((10, 3)))


def test_a_result_without_a_page_is_refused(run: zygos.Run, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="a Run has no report page"):
        zygos.write_report(run, tmp_path / "page.html")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


# ------------------------------------------------------------------------------------------ the page and the notebook


def brief(load_run):  # type: ignore[no-untyped-def]
    """A function that loads runs, and of each demonstration run of the gap only the first 12 s."""

    def loaded(path, *arguments):  # type: ignore[no-untyped-def]
        run = load_run(path, *arguments)
        if "demo" not in str(path):
            return run
        arrays = {name: getattr(run, name)[run.t < 12.0] for name in ("q", "theta", "tau", "omega")}
        return zygos.make_run(run.arm, **arrays)

    return loaded


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_examples_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(zygos, "load_run", brief(zygos.load_run))
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    used = set(re.findall(r"zygos\.(\w+)", "".join(blocks)))
    named = {"Arm", "ArmCheck", "Check", "Cycles", "Effect", "Estimation", "Explanation", "Model", "Prediction", "Run"}
    named |= {"Bound", "GroundEstimate", "Payload", "Refinement", "Score"}
    assert set(zygos.__all__) - used == named | {"Scenario", "Simulation", "Undecided"}, "each function has an example"
    names: dict[str, object] = {}
    for k, block in enumerate(blocks):
        exec(compile(block, f"docs/python.md, example {k + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "12 of 12 intervals hold the true value" in said
    assert "named - The simulation lacks Coulomb friction at the motor (elbow)" in said
    assert "nowhere.toml: no such file; remedy: check the path" in said
    assert {path.name for path in tmp_path.iterdir()} == {
        "my-arm", "slower.toml", "stiffer.toml", "learned.toml", "refined.toml", "gap.html", "found.png", "00", "01",
        "02", "03",
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_notebook_runs(tmp_path: Path) -> None:
    """From top to bottom, outside the checkout; what is committed has no outputs."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(ROOT / "examples" / "notebook" / "zygos.ipynb", as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)
    shorter = f"import zygos\n{inspect.getsource(brief)}\nzygos.load_run = brief(zygos.load_run)\n"
    shorter += "simulate = zygos.simulate\n"
    shorter += "zygos.simulate = lambda *settings, **options: simulate(*settings, **(options | {'duration_s': 12.0}))"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(shorter))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in code for output in cell.outputs]
    assert not any(output.output_type == "error" or output.get("name") == "stderr" for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 3, "the charts are drawn"
    text = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "of 12 intervals hold the true value" in text
    assert "Coulomb friction at the motor (elbow)" in text
