"""Scenes with truth, for tests, examples and training: people, rigs, and what detectors see."""
