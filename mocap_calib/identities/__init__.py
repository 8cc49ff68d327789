"""Identities through time: pieces of tracks and their joining."""
