"""Finding cameras: those of the network, those of this machine, and what each of them sees."""
