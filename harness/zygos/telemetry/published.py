# SPDX-License-Identifier: MIT
"""What a run says, as topics of ROS 2 for programs that draw signals."""

from __future__ import annotations

import numpy as np

from zygos.arm import Arm
from zygos.files.mcap import Topic
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate, usable


def measured(arm: Arm, cycles: Cycles) -> list[Topic]:
    """Angles and torques behind the gear: `/measured/joint_states`, and `/measured/motor_states` of an arm with
    flexible joints. Cycles that are not usable are left out."""
    samples, kept = calibrate(arm, cycles), usable(cycles)
    names = tuple(joint.name for joint in arm.joints)
    t = (samples.sync[kept] - samples.sync[0]).astype(np.float64) * arm.period_s if len(cycles) else np.zeros(0)
    flexible = np.array([joint.flexible for joint in arm.joints])
    angle = np.where(flexible, samples.q, samples.theta)[kept]
    effort = (samples.tau * arm.gear_ratios)[kept]
    topics = [Topic("/measured/joint_states", names, t, angle, None, effort)]
    if flexible.any():
        topics.append(Topic("/measured/motor_states", names, t, samples.theta[kept], None, None))
    return topics
