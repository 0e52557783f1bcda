"""The CAN side: buses, logs and their repair, the DBC of the wire, bus load."""
