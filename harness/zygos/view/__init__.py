# SPDX-License-Identifier: MIT
"""Display of the arm of a run in three dimensions."""
