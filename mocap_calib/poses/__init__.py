"""Poses that are more than triangulated points: smooth in time, of constant bones, without gaps."""
