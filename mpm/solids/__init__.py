"""Solids for the kernel: their faces, those near each cell, and the nearest to a particle."""
