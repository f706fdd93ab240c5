"""What can be unknown of a scene, and how its value enters the MPM and the surrogate."""
