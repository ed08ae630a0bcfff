"""One interface: its facets and points, tau_s, return map, history, terms of the forms, tangent."""
