# SPDX-License-Identifier: MIT
"""An arm that shares no equations with the package: MuJoCo moves it, laws that the package does not know act on it."""
