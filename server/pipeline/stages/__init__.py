"""From pictures to packets: read, train, encode, side by side."""
