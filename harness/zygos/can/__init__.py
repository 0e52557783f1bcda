# SPDX-License-Identifier: MIT
"""The CAN side: buses, logs and the reading of damaged ones, the DBC of the protocol, bus load."""
