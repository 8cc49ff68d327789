"""Uncertainty, checks and verdict of a rig."""
