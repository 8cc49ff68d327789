"""Camera files, a module a family of formats."""
