# SPDX-License-Identifier: MIT
"""Accuracy of every estimator, coverage of its intervals, and cases in which it refuses: `make accuracy`.

A case is a plant with its sensors and the information that the estimators get. A cell simulates some seeds of a case,
gives their CAN frames to every estimator and writes the answers to a file, one line per cell. Only `summary`, which
reads those lines, compares the answers with the true values.
"""
