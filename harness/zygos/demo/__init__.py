# SPDX-License-Identifier: MIT
"""The demonstration that `make` runs: the paper's example from simulated frames to a scored report."""
