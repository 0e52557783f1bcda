"""Equations of motion of an arm, planar and spatial, ours and those of independent engines."""
