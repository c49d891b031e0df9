"""A policy in another process or on another machine: wire, client, server."""
