"""Everything solid, as data: shapes, the files they come from, the boundary of their union, distances from it."""
