"""The terms of a step, a file each: transfer, grid, stress, plasticity, walls, contact, volume correction."""
