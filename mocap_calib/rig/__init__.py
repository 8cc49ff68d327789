"""Cameras from pairs: graph of pairs, averaging, association in a frame, triangulation."""
