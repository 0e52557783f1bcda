"""What a run says of its own arm file: which signal is swapped, inverted, stuck, saturated, skewed or of another scale.

No model is needed. Angles, rates and accelerations come from one smooth window phi(t) that slides over the readings:
a reading's mean, and after integration by parts those of its rate and acceleration, are sums of readings with weights
phi, -phi' and phi'' (Shinbrot's modulating functions). Nothing is differentiated, and a reading that is latched late is
weighted where it was taken. What these means must satisfy decides (docs/check-arm.md):

    motor of a flexible joint   tau = Im n thetadd + k/n (theta - q) + b/n (thetad - qd) + friction, Im, k, b >= 0
    both encoders of a joint    theta - q = what the spring carries + skew * rate + zero
    the whole arm               the energy balance of the C library closes (`Estimate.residual`)

Each fault is a change to the readings; the one under which the equations hold best is named, if it wins by `SURE`.
"""

from zygos.audit.auditor import audit
from zygos.audit.findings import Audit, Pair, Signal, SignalFault, Traffic, signal_names

__all__ = ["Audit", "Pair", "Signal", "SignalFault", "Traffic", "audit", "signal_names"]
