"""Where work is done: threads, processes, and the machines of a cluster."""

# environment variables that hold the libraries of linear algebra to so many threads; they are read
# when numpy is imported. Apple's, the last, knows no other way.
BLAS_THREADS = ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
