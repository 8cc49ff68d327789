"""Compiled loops: each is the only definition of its computation."""
