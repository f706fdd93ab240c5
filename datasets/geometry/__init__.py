"""Solid geometry as data: shapes, their files, the boundary of their union, and distances from it."""
