# SPDX-License-Identifier: MIT
"""The gap of an arm on the ground: a fixed base and rigid joints, explained by rows of its joints."""
