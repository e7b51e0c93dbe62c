"""The ingest and streaming server, and the `streamlod` command line."""
