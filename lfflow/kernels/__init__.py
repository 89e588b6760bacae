"""Array kernels: numpy in, numpy out; no labels, no files, no schedulers."""
