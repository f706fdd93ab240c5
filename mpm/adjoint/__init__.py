"""The solver's own adjoint: the exact derivative of a run with respect to everything that it begins with.

    J, slope = gradient(scene, objective)       # objective(positions, velocities) gives J and its derivatives
    slope.velocities, slope.material("friction_deg"), slope.setting("floor_friction"), slope.along(scene_at, 0.0)

The adjoint of a quantity x is its bar, dJ/dx, in names `x_bar` (Griewank & Walther, Evaluating derivatives, 2008).
Every term of a step has its reverse by hand, in the file of the same name as in `mpm.physics`, in the same vectors of
lanes:

    transfer            both transfers, with the motion of the weights
    grid, boundary      gravity, damping, AFLIP's change of velocity; barriers; walls with Coulomb friction, open sides
    stress, principal, mohr_coulomb     elastic trial, axes, the plastic return on each of its pieces, softening
    contact, faces      traction, friction and position of baffles, ground and obstacles
    volume_correction   the gap that follows the grid's density, and the stress of cracks
    particles, properties, kernel       a block of particles, bars of materials; replay and reverse of a segment
    tape, gradient      checkpoints within a budget of memory; what a user calls

Scenes and threads are the solver's: several scenes side by side, or one large scene on all threads. The particles of a
very large scene are not sorted as the solver does, so that sums differ in their last bits.

Taichi 1.7.4 differentiates a kernel that reads one array and writes another, vectors of lanes included. Where a loop
overwrites what it has read, as each of our steps does, it silently takes the last value for all; hence the reverse by
hand. There is no tangent: a Jacobian of M numbers is one replay with M reverses, and for few unknowns differences and
secants cost less than either (docs/efficiency.md).
"""
