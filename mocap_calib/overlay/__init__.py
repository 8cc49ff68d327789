"""What a run found, drawn on the frames of its videos."""
