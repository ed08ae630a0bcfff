"""Other cohesive codes, each in a process of an environment of its own, on the same scenes."""
