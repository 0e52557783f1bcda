# SPDX-License-Identifier: MIT
"""A scenario simulated: the run that sensors record, and, apart from it, what only the simulator knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.dynamics.equations import ENGINES
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.simulation import plant
from zygos.simulation.scenario import Scenario


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """A simulated run together with the truth behind it. Only a score of estimates has a use for the truth."""

    arm: Arm
    model: Model
    trajectory: plant.Trajectory
    """The exact motion at n SYNC instants of one seed: t (n,) s; q, theta (1, n, N) rad; qd, thetad (1, n, N) rad/s;
    tau (1, n, N) Nm; omega0, the base rate, rad/s."""

    @cached_property
    def run(self) -> Run:
        """What the sensors say, as the frames of a bus."""
        return Run.of_cycles(self.arm, self.trajectory.cycles())

    @property
    def true_values(self) -> NDArray[np.float64]:
        """(p,) the plant's base parameters in the order of `Arm.parameter_names`, SI units."""
        return self.model.base_values(self.arm)


def simulate_with_truth(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    *,
    seed: int | None = None,
    noise: bool | None = None,
    duration_s: float | None = None,
    engine: str = "zygos",
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate as `simulate`, with the same errors, and keep the exact motion and the plant's values."""
    chosen = next((name for name in ENGINES if name == engine), None)
    if chosen is None:
        raise ZygosError(f"there is no engine {engine!r}; remedy: one of {', '.join(ENGINES)}")
    if seed is not None and seed < 0:
        raise ZygosError(f"seed {seed} is negative; remedy: a whole number from 0")
    trajectory = plant.simulate(
        arm,
        model,
        scenario,
        engine=chosen,
        seeds=None if seed is None else [seed],
        noise=noise,
        duration_s=duration_s,
        progress=progress,
    )
    return Simulation(arm, model, trajectory)


def simulate(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    *,
    seed: int | None = None,
    noise: bool | None = None,
    duration_s: float | None = None,
    engine: str = "zygos",
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Simulate a scenario in closed loop: the run that the sensors of the arm record, as frames of its bus.

    seed: of the sensor noise, by default the scenario's. noise: whether sensors are noisy, by default as the scenario
    says. duration_s: by default the scenario's. engine: whose equations of motion are integrated, "zygos", "pinocchio"
    or "mujoco"; those of others know no effects. progress is called now and then with the share that is done.

    Errors: ZygosError if arm, model and scenario do not fit each other, for an unknown engine, or if the motion
    diverges.
    """
    return simulate_with_truth(
        arm, model, scenario, seed=seed, noise=noise, duration_s=duration_s, engine=engine, progress=progress
    ).run
