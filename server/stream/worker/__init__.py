"""Parts of a stream that a worker process makes; none of them knows the process."""
