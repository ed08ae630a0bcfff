"""Motion in time: the peer, and steps."""
