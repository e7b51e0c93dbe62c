"""Numba kernels of the trainer, for the CPU: what torch would do in many small passes over memory, in one."""
