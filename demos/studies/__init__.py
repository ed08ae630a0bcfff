"""Studies: each measures one property of the method over many runs."""
