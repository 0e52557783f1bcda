# SPDX-License-Identifier: MIT
"""Where simulation and measurement disagree, which effect is missing, and how far the gap shrinks once it is added.

record -> balances -> fit <- twin        which balance fails, and by how much more than the model's own twin
                       |
                    search -> verdict -> forecast        the effect, its evidence, and the gap before and after
"""
