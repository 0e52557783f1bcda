# SPDX-License-Identifier: MIT
"""Write the logs of examples/gap/demo: PYTHONPATH=tests:tests/support python -m oracles.demo_log [folder]

The arm that is recorded is not quite the one drawn in cad.toml, and its elbow's motor has friction. What is hidden is
in sealed.json. The same machine writes the same bytes each time.
"""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from oracles.laws import MotorCoulomb
from oracles.simulate import run, write
from zygos.arm import load_arm
from zygos.model.model import Model, Quantity, load_model
from zygos.simulation.scenario import load_scenario

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "gap"
RUNS = ("a", "b", "c", "d")
ELBOW = 1
HIDDEN = MotorCoulomb(joint=ELBOW, size=0.03)
SEED = 20


def built(drawn: Model, seed: int) -> Model:
    """The arm as it was built: every quantity off by at most its sigma."""
    random = np.random.default_rng(seed)

    def off(quantity: Quantity) -> Quantity:
        return replace(quantity, value=quantity.value + quantity.sigma * float(random.uniform(-1.0, 1.0)))

    bodies = []
    for body in drawn.bodies:
        ixx, ixy, ixz, iyy, iyz, izz = map(off, body.inertia)
        bodies.append(replace(body, mass=off(body.mass), inertia=(ixx, ixy, ixz, iyy, iyz, izz)))
    joints = [
        replace(
            joint,
            rotor_mass=off(joint.rotor_mass),
            rotor_inertia=off(joint.rotor_inertia),
            stiffness=off(joint.stiffness),
            damping=off(joint.damping),
        )
        for joint in drawn.joints
    ]
    return replace(drawn, bodies=tuple(bodies), joints=tuple(joints))


def main(folder: Path) -> None:
    """Write a.blf, b.blf, c.blf, d.blf and sealed.json."""
    arm = load_arm(EXAMPLE / "arm.toml")
    model = built(load_model(EXAMPLE / "cad.toml"), SEED)
    digests = {}
    for name in RUNS:
        scenario = load_scenario(EXAMPLE / f"{name}.toml")
        log = folder / f"{name}.blf"
        write(run(arm, model, scenario, scenario.seed, HIDDEN), arm, log)
        digests[log.name] = hashlib.sha256(log.read_bytes()).hexdigest()
        print(f"{log}: {log.stat().st_size:,} bytes")
    sealed = {
        "hidden": HIDDEN.key,
        "where": arm.joints[HIDDEN.joint].name,
        "law": f"rotor torque {HIDDEN.form}, v0 = {HIDDEN.v0} rad/s",
        "size": HIDDEN.size,
        "unit": HIDDEN.unit,
        "true_values": dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True)),
        "sha256": digests,
    }
    (folder / "sealed.json").write_text(json.dumps(sealed, indent=2) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else EXAMPLE / "demo")
