"""Forward models behind one interface: the surrogate and the MPM."""
