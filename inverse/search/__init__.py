"""The search in waves, for every forward model: runs, their evaluation, and more runs where they leave most open."""
