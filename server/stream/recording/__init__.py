"""What a server keeps of its streams on disk."""
