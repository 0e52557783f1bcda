# SPDX-License-Identifier: MIT
"""The simulated plant: scenario, motion, sensors, and the scorer that compares estimates with its true values."""
