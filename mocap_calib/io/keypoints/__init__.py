"""Keypoint files, a module a format."""
