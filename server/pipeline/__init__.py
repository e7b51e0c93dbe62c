"""From pictures to packets: job, stages, trace."""
