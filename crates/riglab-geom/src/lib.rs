//! Surface sampling, farthest points, nearest neighbours.
