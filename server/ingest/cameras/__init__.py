"""Camera addresses, rig definitions and readers."""
