"""The pictures of one instant on their way into training."""
