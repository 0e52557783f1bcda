# SPDX-License-Identifier: MIT
"""MJCF files of arms with springs and of bases that float."""

from __future__ import annotations

from collections.abc import Sequence

FREE_FLYER = """<mujoco model="free-flyer">
  <!-- examples/gap: each rotor is a body of its own -->
  <option gravity="0 0 0" timestep="0.001" integrator="implicitfast"/>
  <default><default class="rotor"><joint axis="0 0 1"/></default></default>
  <worldbody>
    <body name="base" pos="1 2 3" euler="20 30 10">
      <freejoint/>
      <inertial pos="0 0 0" mass="4000" diaginertia="666.7 666.7 666.7"/>
      <body name="shoulder_rotor" pos="5 0 0">
        <joint name="shoulder_motor" class="rotor"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.5 0.5 1"/>
      </body>
      <body name="link1" pos="5 0 0">
        <joint name="shoulder" axis="0 0 1"/>
        <inertial pos="5 0 0" mass="200" diaginertia="33.3 33.3 33.3"/>
        <body name="elbow_rotor" pos="10 0 0">
          <joint name="elbow_motor" class="rotor"/>
          <inertial pos="0 0 0" mass="1" diaginertia="0.5 0.5 1"/>
        </body>
        <body name="link2" pos="10 0 0">
          <joint name="elbow" axis="0 0 1"/>
          <inertial pos="2.5 0 0" mass="1000" diaginertia="50 50 50"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="shoulder_spring" stiffness="3000" damping="85">
      <joint joint="shoulder_motor" coef="0.02"/><joint joint="shoulder" coef="-1"/>
    </fixed>
    <fixed name="elbow_spring" stiffness="1000" damping="75">
      <joint joint="elbow_motor" coef="0.02"/><joint joint="elbow" coef="-1"/>
    </fixed>
  </tendon>
</mujoco>
"""
"""The arm of examples/gap, in another place and attitude."""
AXES = ("0 0 1", "0 1 0", "1 0 0")
IN_SPRINGS = ("motor_viscous", "link_viscous", "motor_coulomb", "link_coulomb", "cubic_stiffness", "spring_offset",
              "backlash")  # fmt: skip
"""Effects that the file of a flexible joint holds."""


def serial(floats: bool, flexible: Sequence[bool], ratio: float) -> str:
    """An arm in space of three joints about AXES, with bodies of no symmetry; one on a fixed base feels gravity."""
    bodies, tendons, close = "", "", ""
    for k, (axis, soft) in enumerate(zip(AXES, flexible, strict=True), start=1):
        place = f'pos=".{k} .05 .{4 - k}"'
        if soft:
            bodies += f'<body name="rotor{k}" {place}><joint name="motor{k}" axis="{axis}" ref="{3 * k}"/>\n'
            across = " ".join("4e-4" if one == "1" else "3e-4" for one in axis.split())
            bodies += f'  <inertial pos="{axis}" mass=".2" diaginertia="{across}"/></body>\n'
            tendons += f'<fixed stiffness="{20 * k}" damping="{0.03 * k}"><joint joint="joint{k}" coef="{-0.1 * k}"/>'
            tendons += f'<joint joint="motor{k}" coef="{0.1 * k / ratio}"/></fixed>\n'
        bodies += f'<body name="link{k}" {place}><joint name="joint{k}" axis="{axis}" ref="{10 * k}"/>\n'
        bodies += f'  <inertial pos=".03 -.0{k} .1" mass="{4 - k}" fullinertia=".04 .05 .03 .002 .001 -.003"/>\n'
        close += "</body>"
    base = '<body name="base" pos="1 2 3" euler="20 30 10"><freejoint/>\n'
    base += '<inertial pos=".1 -.2 .05" mass="9" fullinertia=".6 .5 .4 .02 .01 -.03"/>\n'
    gravity = "0 0 0" if floats else "1 -2 -9"
    return (
        f'<mujoco><compiler angle="degree"/><option gravity="{gravity}" timestep="1e-5"/>\n'
        f"<worldbody>{base if floats else ''}{bodies}{close}{'</body>' if floats else ''}</worldbody>\n"
        f"<tendon>{tendons}</tendon></mujoco>\n"
    )
