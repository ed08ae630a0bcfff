"""Results: fields for ParaView, values and profiles of interfaces, the history of a run."""
