"""Fault hypotheses of single cameras."""
