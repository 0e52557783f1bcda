"""Somebody else's telemetry: map.toml, the grid of cycles, conversion."""
