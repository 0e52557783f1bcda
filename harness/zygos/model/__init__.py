# SPDX-License-Identifier: MIT
"""Models of an arm: bodies, base parameters, and the fit of bodies to base parameters."""
