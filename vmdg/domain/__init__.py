"""The bodies: mesh topology, tags, cell checks, materials on cells, geometry."""
