"""Functions and constants that are compiled into the kernels beside this folder."""
