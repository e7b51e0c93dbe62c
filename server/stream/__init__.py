"""One stream: its live end, its recording, its broadcast."""
