# SPDX-License-Identifier: MIT
"""Files and streams: TOML, tables, standard input and output, progress."""
