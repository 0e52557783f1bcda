# SPDX-License-Identifier: MIT
"""The C library that flies, through cffi: estimator, snapshots, generated configuration."""
