"""One viewer's session: live, replayed, or drawn by the server."""
