# SPDX-License-Identifier: MIT
"""Estimation on the ground with the flight library: monitoring a run, verdicts and remedies in words."""
