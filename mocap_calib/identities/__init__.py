"""Identities through time: tracklets and their joining."""
