"""Runs whose mesh changes: the state on another mesh, and where the mesh is too coarse."""
