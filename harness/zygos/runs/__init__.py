# SPDX-License-Identifier: MIT
"""A recorded run: cycles, tables of cycles, calibrated samples, smoothed instants."""
