"""Figures, tables and animations; of a study they read nothing but its dataset."""
