"""Messages and packets of the viewer protocol."""
