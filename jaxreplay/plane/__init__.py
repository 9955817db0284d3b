"""A robot, a cube and an experimental area on a plane; knows nothing of the filter."""
