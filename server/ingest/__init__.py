"""Real cameras in: sources, capture clocks, the synchroniser, and the live data set that training reads."""
