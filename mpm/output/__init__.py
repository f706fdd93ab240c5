"""The records of a run: requested frames, forces, rest, a state to continue from, a summary."""
