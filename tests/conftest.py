# SPDX-License-Identifier: MIT
"""What the tests share: the example, and one simulation of it a session."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from arm_support import exact_example
from numpy.typing import NDArray
from runs_support import trajectory_of

from zygos.arm import Arm, load_arm
from zygos.model.model import Model, load_model
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario, load_scenario

pytest_plugins = ["zygos.testing", "tiers", "schema_support", "recorded_support"]

ROOT = Path(__file__).resolve().parent.parent
PAPER = ROOT / "examples" / "paper"
"""The paper's own arm and motion, of which test_paper.py and the cases paper-* of the campaign tell."""
EXAMPLE = exact_example(ROOT / "examples" / "lively", ROOT / "build" / "examples" / "lively")
"""The motion of all fixtures: every parameter shows in it. Its torque sensors are exact; other arms have tests of
their own."""
IN_SPACE = exact_example(ROOT / "examples" / "spatial", ROOT / "build" / "examples" / "spatial")
"""The arm in space, likewise with exact torque sensors."""


def need(found: object, what: str) -> None:
    """A missing tool is a failure in CI and a clear message elsewhere."""
    if not found:
        if os.environ.get("CI"):
            pytest.fail(f"missing in CI: {what}")
        pytest.skip(f"missing here: {what}", allow_module_level=True)


def tool_module(name: str) -> ModuleType:
    """A module of tools/, which is no package."""
    folder = str(ROOT / "tools")
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(name)


def house_flags() -> list[str]:
    """The flags that tools/build_native.py compiles with, less those of a shared object."""
    return [flag for flag in tool_module("build_native").FLAGS.split() if flag not in ("-g", "-fPIC")]


@pytest.fixture(scope="session")
def arm() -> Arm:
    return load_arm(EXAMPLE / "arm.toml")


@pytest.fixture(scope="session")
def model() -> Model:
    return load_model(EXAMPLE / "model.toml")


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return load_scenario(EXAMPLE / "scenario.toml")


@pytest.fixture(scope="session")
def true(arm: Arm, model: Model) -> NDArray[np.float64]:
    """(p,) what only the plant and a scorer know."""
    return model.base_values(arm)


@pytest.fixture(scope="session")
def clean(arm: Arm, model: Model, scenario: Scenario) -> Callable[[float], Trajectory]:
    """The example without noise at a given SYNC period."""
    return lambda period_s=arm.period_s: trajectory_of(arm, model, scenario, noise=False, period_s=period_s)


@pytest.fixture(scope="session")
def noisy(arm: Arm, model: Model, scenario: Scenario) -> Trajectory:
    """The example with the noise of the paper, seeds 0 .. 49."""
    return trajectory_of(arm, model, scenario, seeds=range(50), noise=True)
