# SPDX-License-Identifier: MIT
"""Files of other simulators (MJCF, URDF): read as an arm and a model, corrected in place, and measured in MuJoCo."""
