# SPDX-License-Identifier: MIT
"""Estimates on the ground of arms with a fixed base and rigid joints: least squares of the joint rows of one or several
runs."""
