"""Random scenes far from ordinary, run and examined."""
