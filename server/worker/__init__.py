"""The worker process that makes packets, and its supervisor."""
