"""The board: its description, its print at true size, and its corners in pictures."""
