"""Workers on a Ray cluster: a local process places an actor, which does the work and is connected to it by TCP."""
