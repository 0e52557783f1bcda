# SPDX-License-Identifier: MIT
"""Weeks of flight at an accelerated pace (`make soak`, docs/soak.md)."""
