# SPDX-License-Identifier: MIT
"""`make verify`: gathers the evidence for the C library (docs/verification.md)."""
