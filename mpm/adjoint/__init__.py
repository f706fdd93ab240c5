"""The solver's own adjoint: the exact derivative of a run with respect to everything that it begins with.

Every term of a step has its reverse by hand, in the file of the same name as in `mpm.physics`, in the same vectors of
lanes and on the same threads:

    transfer            both transfers, with the motion of the weights
    grid, boundary      gravity, damping, AFLIP's change of velocity; walls with Coulomb friction
    stress, principal, mohr_coulomb     elastic trial, axes, the plastic return on each of its pieces
    particles, kernel   a block of particles; replay and reverse of a segment of steps
    tape, gradient      checkpoints within a budget of memory; what a user calls

Taichi 1.7.4 differentiates a kernel that reads one array and writes another, vectors of lanes included. Where a loop
overwrites what it has read, as each of our steps does, it silently takes the last value for all: of five steps
a <- a + 0.1 sin a from a = 1 it says 1.058 where the derivative is 1.205; hence the reverse by hand.
"""
