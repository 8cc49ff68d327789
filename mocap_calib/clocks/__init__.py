"""Time offsets, rates and lost frames of cameras."""
