"""One recording from its files to its results."""
