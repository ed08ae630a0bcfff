"""Results: fields for ParaView, values and profiles of interfaces, the table of a run."""
