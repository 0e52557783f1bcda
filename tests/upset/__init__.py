# SPDX-License-Identifier: MIT
"""Single-bit upsets in the memory of the flight library: what they do (`make upset`)."""
