"""What is recorded of a run: frames on request, forces, rest, a state to go on from, a summary."""
