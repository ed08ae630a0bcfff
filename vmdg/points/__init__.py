"""Where an interface is: its description, facets, pairs of facets, and points on both sides."""
