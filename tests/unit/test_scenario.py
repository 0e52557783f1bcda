# SPDX-License-Identifier: MIT
"""The scenario file: desired motions, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plant_support import LIVELY, lively

from zygos.errors import ZygosError
from zygos.simulation.scenario import Motion, Ramp, Sine, load_scenario


def test_desired_rate_is_the_derivative_of_the_angle() -> None:
    motion = Motion(0.2, (Sine(0.5, 1.3, 0.4), Sine(0.1, 7.0)), (Ramp(2.0, 3.0, -1.5),))
    t = np.linspace(0.0, 8.0, 4001)
    angle, rate = motion.desired(t)
    np.testing.assert_allclose(np.gradient(angle, t)[1:-1], rate[1:-1], atol=1e-3)
    assert motion.desired(0.0)[0] == pytest.approx(0.2 + 0.5 * np.sin(0.4))


def test_a_ramp_starts_and_ends_at_rest() -> None:
    angle, rate = Motion(ramps=(Ramp(1.0, 2.0, 0.8),)).desired([0.0, 1.0, 2.0, 3.0, 9.0])
    np.testing.assert_allclose(angle, [0, 0, 0.4, 0.8, 0.8], atol=1e-15)
    np.testing.assert_allclose(rate, [0, 0, 0.4 * np.pi / 2, 0, 0], atol=1e-15)


def test_kinds_of_manoeuvre_add_up(tmp_path: Path) -> None:
    for name in ("arm.toml", "model.toml"):
        (tmp_path / name).write_text("")
    file = tmp_path / "scenario.toml"
    file.write_text("""
        name = "sum"
        duration_s = 10
        [[manoeuvre]]
        joint = "a"
        kind = "constant"
        angle_rad = 0.5
        [[manoeuvre]]
        joint = "a"
        kind = "sines"
        sines = [{ amplitude_rad = 0.3, omega_rad_s = 2.0 }]
        [[manoeuvre]]
        joint = "a"
        kind = "ramp"
        start_s = 1.0
        duration_s = 2.0
        change_rad = 1.0
    """)
    scenario = load_scenario(file)
    assert scenario.manoeuvre == {"a": Motion(0.5, (Sine(0.3, 2.0, 0.0),), (Ramp(1.0, 2.0, 1.0),))}
    assert scenario.arm == tmp_path / "arm.toml"
    assert (scenario.noise, scenario.encoder_noise, scenario.controller.angle) == (True, "gaussian", "motor")
    angle, _ = scenario.desired(["a"], np.array([0.0, 5.0]))
    np.testing.assert_allclose(angle[:, 0], [0.5, 0.5 + 0.3 * np.sin(10.0) + 1.0])
    with pytest.raises(ZygosError, match="remedy"):
        scenario.desired(["b"], 0.0)


def test_the_papers_controller() -> None:
    scenario = lively()[2]
    assert (scenario.controller.kp, scenario.controller.kd, scenario.controller.angle) == (1000.0, 250.0, "motor")
    assert scenario.angular_momentum_nms == 1.0
    assert scenario.plant.name == "model.toml"


@pytest.mark.parametrize(("find", "put", "key"), [
    ('arm = "arm.toml"', 'arm = "none.toml"', "arm: .*none.toml: no such file"),
    ("duration_s = 60.0", "duration_s = -1", "duration_s"),
    ("seed = 0", "seed = -1", "seed"),
    ("noise = true", 'noise = "no"', "noise"),
    ('encoder_noise = "gaussian"', 'encoder_noise = "uniform"', "encoder_noise"),
    ("initial_angles_rad = [1.25, -2.0]", "initial_angles_rad = [0.0]", "initial_angles_rad"),
    ("gain = 1.0", "gain = -1.0", r"controller\.gain"),
    ("gain = 1.0", "gains = 1.0", r"controller\.gains: unknown key"),
    ('angle = "motor"', 'angle = "both"', r"controller\.angle"),
    ('kind = "sines"', 'kind = "sine"', r"manoeuvre\[0\]\.kind"),
    ('kind = "sines"', 'kind = "constant"', r"manoeuvre\[0\]\.angle_rad: is missing"),
    ("[controller]", "[bus]\n[controller]", "bus: unknown key"),
])  # fmt: skip
def test_bad_files_are_refused(tmp_path: Path, find: str, put: str, key: str) -> None:
    for name in ("arm.toml", "model.toml"):
        (tmp_path / name).write_text((LIVELY / name).read_text())
    text = (LIVELY / "scenario.toml").read_text()
    assert find in text
    file = tmp_path / "scenario.toml"
    file.write_text(text.replace(find, put, 1))
    with pytest.raises(ZygosError, match=rf"scenario\.toml: {key}") as refusal:
        load_scenario(file)
    assert "; remedy: " in str(refusal.value)
