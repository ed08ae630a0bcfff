"""Random scenes of every kind of interface, and what each is compared with."""
