"""What the server answers: REST, the live websocket, health."""
