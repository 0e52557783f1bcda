"""URDF: import and export."""
