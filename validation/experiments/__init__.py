"""Measured experiments: each a folder with its scene, its numbers, their spread, source and licence."""
