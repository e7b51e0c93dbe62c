"""A pretend GPU: finds, on a machine without one, code that a GPU would refuse or wait for."""
