"""Error against cost of the MPM, and whether --tolerance holds."""
