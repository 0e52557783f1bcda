# SPDX-License-Identifier: MIT
"""What the frames of a motion can tell at most, from equations of motion with all their derivatives."""
