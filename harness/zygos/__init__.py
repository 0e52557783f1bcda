"""The dynamics of a flexible-joint space arm, learned from its CAN frames: the ground harness of the C library."""
