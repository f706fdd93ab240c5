"""The particles and what is around them: state, units, solids, contact, background grid, known forces."""
