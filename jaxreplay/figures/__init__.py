"""Figures, tables and animations; of a study they read its dataset, or the trace of one run."""
