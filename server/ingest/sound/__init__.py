"""The sound of a live rig: heard, stamped by the clock of its pictures, and encoded."""
