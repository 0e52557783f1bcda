# SPDX-License-Identifier: MIT
"""Report pages: one self-contained HTML file each."""
