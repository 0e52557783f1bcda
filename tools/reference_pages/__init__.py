# SPDX-License-Identifier: MIT
"""The reference pages in docs/reference/ (tools/reference.py writes them)."""
