# SPDX-License-Identifier: MIT
"""The balances that every estimate rests on: kinematics, and rows of energy, motor impulse and momentum."""
