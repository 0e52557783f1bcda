# SPDX-License-Identifier: MIT
"""Checks an arm file against a run: which signal is swapped, inverted, stuck, saturated, skewed or wrongly scaled.

No model is needed. Angles, rates and accelerations come from a smooth window phi(t) that slides over the readings: the
windowed mean of a reading and, after integration by parts, those of its rate and acceleration are sums of readings with
weights phi, -phi' and phi'' (Shinbrot's modulating functions). Nothing is differentiated, and a reading that is latched
late is weighted at the instant of its latch. The means must satisfy these equations (docs/check-arm.md):

    motor of a flexible joint   tau = Im n thetadd + k/n (theta - q) + b/n (thetad - qd) + friction, Im, k, b >= 0
    both encoders of a joint    theta - q = deflection under the spring's torque + skew * rate + zero
    the whole arm               the energy balance of the C library closes (`Estimate.residual`)

Each fault is a change of the readings; the fault under which the equations hold best is reported, if it is better by
`SURE`.
"""

from zygos.audit.auditor import audit
from zygos.audit.findings import Audit, Pair, Signal, SignalFault, Traffic, signal_names

__all__ = ["Audit", "Pair", "Signal", "SignalFault", "Traffic", "audit", "signal_names"]
