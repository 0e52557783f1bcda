# SPDX-License-Identifier: MIT
"""Telemetry of other systems: map.toml, the grid of cycles, conversion."""
