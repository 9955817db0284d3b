"""The worlds in which the runs of a study happen: the simulated plane, or any environment."""
