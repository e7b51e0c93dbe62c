"""Streams that several servers share over NATS JetStream: published by the one that trains, served by every other."""
