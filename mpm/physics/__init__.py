"""The terms of a step, a file each: transfer, grid, stress, walls, contact, volume correction, water."""
