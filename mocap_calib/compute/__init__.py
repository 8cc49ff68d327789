"""Where work is done: threads, processes, and the machines of a cluster."""
