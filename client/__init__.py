"""The viewers: a Python websocket client and the browser page (`client/web`)."""
