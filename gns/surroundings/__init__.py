"""The particles and their surroundings: state, units, solids, contact, background grid, known forces."""
