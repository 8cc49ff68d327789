"""Relative pose and correspondences of two views."""
