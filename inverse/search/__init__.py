"""The search in waves, for every forward model: runs, what they say, and more runs where they say least."""
