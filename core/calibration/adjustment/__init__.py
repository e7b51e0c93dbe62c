"""Bundle adjustment: projection, rigid transforms, the minimiser, and what is adjusted."""
