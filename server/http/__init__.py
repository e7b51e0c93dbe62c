"""HTTP and websocket protocols with limits, and the viewer page's files."""
