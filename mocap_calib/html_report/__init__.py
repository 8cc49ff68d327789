"""report.html: one file that shows what a run found, in a browser, without a network."""
