"""The sound that belongs to a `.slod` file: an Ogg Opus file of its own beside it. docs/sound.md."""
