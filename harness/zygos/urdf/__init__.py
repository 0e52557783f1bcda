# SPDX-License-Identifier: MIT
"""URDF: import and export."""
