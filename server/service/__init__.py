"""The service as a process: application, metrics, sockets and signals."""
