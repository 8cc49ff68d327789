"""Lifting: 3D predictions of bodies from one view, in numpy."""
