# SPDX-License-Identifier: MIT
"""Motions that excite: what a motion will tell about each parameter, and the search for one that tells most."""
