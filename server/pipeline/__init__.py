"""From pictures to packets: what a job is, and how it is done."""
