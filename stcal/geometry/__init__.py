"""Rotations and directions, batched."""
