"""The bodies: mesh topology, tags, checks of cells, materials on cells, geometry."""
