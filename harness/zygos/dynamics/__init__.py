# SPDX-License-Identifier: MIT
"""Equations of motion of an arm, planar and spatial: our own, and those of independent engines."""
