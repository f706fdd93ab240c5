"""Solids for the kernel: their faces, which of them are near a cell, and the nearest to a particle."""
