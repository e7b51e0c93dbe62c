"""Time between cameras by what they heard, beside what they saw."""
