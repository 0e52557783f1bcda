# SPDX-License-Identifier: MIT
"""The paper's estimators and tables, compared with the printed ones."""
