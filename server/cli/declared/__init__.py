"""The commands as users see them: names, options, help. Each function imports what it does, which is heavy."""

# In the order in which --help lists them
from streamlod.server.cli.declared import cameras, training, serving, clients, files, machine  # isort: skip

__all__ = ["cameras", "clients", "files", "machine", "serving", "training"]
