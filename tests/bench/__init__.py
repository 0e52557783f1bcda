# SPDX-License-Identifier: MIT
"""What the flight library costs: instructions, bytes, and its peers (`make bench`)."""
